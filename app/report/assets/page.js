"use strict";
// Tables that sort and filter, films, and the choice of shapes.

const one = (selector, root = document) => root.querySelector(selector);
const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const parsed = (id) => JSON.parse(document.getElementById(id).textContent);

function made(tag, text, attributes = {}) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

// Orders numbers and words; what is missing comes last in either direction.
function compare(a, b, sign) {
  const [none, other] = [a === null || a === "", b === null || b === ""];
  if (none || other) return none - other;
  return sign * (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true }));
}

// Calls back with a column and a direction when a head is clicked.
function sortable(heads, sort) {
  heads.forEach((head, column) => {
    if (!head.textContent) return;
    const button = made("button", head.textContent);
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      // Numbers start with the largest, names with the first.
      const before = head.getAttribute("aria-sort");
      const first = head.classList.contains("n") ? "descending" : "ascending";
      const now = !before ? first : before === "ascending" ? "descending" : "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", now);
      sort(column, now === "ascending" ? 1 : -1);
    });
  });
}

for (const table of all("table.sortable")) {
  const value = (row, column) => {
    const cell = row.cells[column];
    const number = parseFloat(cell.dataset.value ?? cell.textContent);
    if (!cell.classList.contains("n")) return cell.textContent;
    return Number.isNaN(number) ? null : number;
  };
  sortable(all("th", table), (column, sign) => {
    const rows = [...table.tBodies[0].rows].sort((a, b) => compare(value(a, column), value(b, column), sign));
    table.tBodies[0].append(...rows);
  });
}

// ---- Kinds of run

function showKind(kind) {
  one("#kind").value = kind;
  for (const part of all("div.kind")) part.hidden = part.dataset.kind !== kind;
}
if (one("#kind").value) showKind(one("#kind").value);
one("#kind").addEventListener("change", (event) => showKind(event.target.value));
one("#kind").parentElement.hidden = one("#kind").length < 2;
for (const button of all("button[data-kind]")) {
  button.addEventListener("click", () => {
    showKind(button.dataset.kind);
    one("#detail").scrollIntoView({ behavior: "smooth" });
  });
}

// ---- Films

const media = parsed("media");
const film = { dialog: one("#film"), pictures: [], timer: null };

function showMoment(k) {
  const [time, picture] = film.pictures[k];
  one("img", film.dialog).src = `data:image/jpeg;base64,${picture}`;
  one("input", film.dialog).value = k;
  one("output", film.dialog).textContent = `${time.toFixed(1)} s`;
}

function play(wanted) {
  clearInterval(film.timer);
  film.timer = wanted ? setInterval(() => showMoment((Number(one("input", film.dialog).value) + 1) % film.pictures.length), 250) : null;
  one("#play").textContent = wanted ? "pause" : "play";
}

function showFilm(number) {
  film.pictures = media.films[number];
  one("#film-title").textContent = nameOf(data.rows[number]);
  one("input", film.dialog).max = film.pictures.length - 1;
  showMoment(0);
  film.dialog.showModal();
  play(true);
}

one("#play").addEventListener("click", () => play(film.timer === null));
one("#close").addEventListener("click", () => film.dialog.close());
film.dialog.addEventListener("close", () => play(false));
one("input", film.dialog).addEventListener("input", (event) => (play(false), showMoment(Number(event.target.value))));

// ---- Shapes

const data = parsed("data");
const [TRUE_COLOUR, PLAIN] = [[120, 178, 140], [200, 202, 200]];

function nameOf([[sweep, object, seed, other, mode, modality, cameras, variant]]) {
  const kind = [mode, modality, cameras, variant.replace(/^full ?/, "")].filter(Boolean).join(" · ");
  return `${data.two ? `${sweep}: ` : ""}${object}, seed ${seed}${other ? ` + ${other}` : ""}, ${kind}`;
}

let view = null;
let shown = [];
let isPlain = false;

// Shows the estimates of runs and the true shape of the first.
function showShapes(numbers) {
  shown = numbers.filter((number) => media.shapes[number]);
  if (!shown.length) return;
  one("#shapes").hidden = false;
  view ??= new ShapeView(one("#stage"));
  const entries = shown.map((number, k) => {
    const name = shown.length > 1 ? `${"AB"[k]}: estimated` : "estimated";
    return [name, shapeOf(media.shapes[number].estimate), isPlain ? PLAIN : null];
  });
  const truth = media.truths[media.shapes[shown[0]].truth];
  if (truth) entries.push(["true", shapeOf(truth), TRUE_COLOUR]);
  view.show(entries);
  one("#shapes select").value = shown[0];
}

for (const number of Object.keys(media.shapes)) one("#shapes select").append(made("option", nameOf(data.rows[number]), { value: number }));
one("#shapes select").addEventListener("change", (event) => showShapes([event.target.value]));
one("#turn").addEventListener("click", (event) => (event.target.textContent = view.spin() ? "stop" : "turn"));
one("#colours").addEventListener("click", (event) => {
  isPlain = !isPlain;
  event.target.textContent = isPlain ? "error colours" : "plain";
  showShapes(shown);
});

// Makes the buttons of films and shapes work, where these are on the page.
function connect(root) {
  for (const button of all("button[data-film]", root)) {
    const number = button.dataset.film;
    button.hidden = !media.films[number];
    button.addEventListener("click", () => showFilm(number));
  }
  for (const button of all("button[data-shapes]", root)) {
    const numbers = button.dataset.shapes.split(",");
    button.hidden = !numbers.some((number) => media.shapes[number]);
    button.addEventListener("click", () => {
      showShapes(numbers);
      one("#shapes").scrollIntoView({ behavior: "smooth" });
    });
  }
}
connect(document);
const first = all("button[data-shapes]").find((button) => !button.hidden)?.dataset.shapes ?? Object.keys(media.shapes)[0];
if (first !== undefined) showShapes(first.split(","));

// ---- Table of all runs

const SHOWN_FIRST = 50;
const table = one("#runs");
const names = ["sweep", "object", "seed", "", "mode", "sensors", "cameras", "variant"];
const isConstant = (k) => new Set(data.rows.map(([row]) => row[k])).size < 2;
// A column in which all rows agree says nothing, except the object's and the seed's.
const kept = names.map((_, k) => k).filter((k) => [1, 2].includes(k) || (k !== 3 && !isConstant(k)) || (k === 3 && !isConstant(k)));
const filled = data.columns.map((_, k) => k).filter((k) => data.rows.some((row) => row[1][k] !== null));
const order = { column: null, sign: 1, all: false };

const heads = [
  ...kept.map((k) => made("th", names[k] || "estimator seed", k === 2 || k === 3 ? { class: "n" } : {})),
  made("th", ""),
  ...filled.map((k) => made("th", data.columns[k][0], { class: "n" })),
  made("th", "end"),
];
const headRow = made("tr");
headRow.append(...heads);
table.tHead.append(headRow);

const valuesOf = (row) => [...kept.map((k) => row[0][k]), null, ...filled.map((k) => row[1][k]), row[2]];
const entries = data.rows.map((row, number) => ({
  row, number, values: valuesOf(row), words: [...row[0], row[2], row[3] ? "undeclared failure" : "", row[4] ?? ""].join(" ").toLowerCase(),
}));

function lineOf({ row, number }) {
  const line = made("tr");
  for (const k of kept) line.append(made("td", row[0][k], k === 2 || k === 3 ? { class: "n" } : {}));
  const actions = made("td", undefined, { class: "buttons" });
  actions.append(made("button", "film", { "data-film": number }), " ", made("button", "3-D", { "data-shapes": number }));
  line.append(actions);
  for (const k of filled) {
    const value = row[1][k];
    line.append(made("td", value === null ? "-" : value.toFixed(data.columns[k][1]), { class: "n" }));
  }
  const end = made("td", row[2]);
  if (row[3]) end.append(made("strong", `${row[2] ? "; " : ""}undeclared failure`));
  line.append(end);
  if (row[4]) line.title = [row[4], row[5], `mambavitact view --run ${row[4]}`].filter(Boolean).join("\n");
  connect(line);
  return line;
}

function showRuns() {
  const words = one("#all input").value.toLowerCase().split(/\s+/).filter(Boolean);
  const found = entries.filter((entry) => words.every((word) => entry.words.includes(word)));
  if (order.column !== null) found.sort((a, b) => compare(a.values[order.column], b.values[order.column], order.sign));
  const count = order.all ? found.length : SHOWN_FIRST;
  table.tBodies[0].replaceChildren(...found.slice(0, count).map(lineOf));
  one("#all output").textContent = `${found.length} of ${entries.length} runs`;
  one("#more").hidden = found.length <= count;
}

sortable(heads, (column, sign) => (Object.assign(order, { column, sign }), showRuns()));
one("#all input").addEventListener("input", showRuns);
one("#more").addEventListener("click", () => ((order.all = true), showRuns()));
showRuns();
