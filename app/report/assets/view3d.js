"use strict";
// Shapes in three dimensions: with WebGL, and without it on a plain canvas by a rasteriser with a depth buffer.
// A shape has positions (mm), normals, colours (0 to 255) and faces; a panel is a shape in its part of the canvas.

const ERROR_STEPS = [[236, 236, 228], [250, 204, 116], [232, 130, 52], [188, 58, 46], [92, 20, 58]];
const LIGHT = [-0.35, 0.5, 0.8].map((x, _, all) => x / Math.hypot(...all));

function bytesOf(text) {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
}

function errorColour(share) {
  const place = Math.min(share, 1) * (ERROR_STEPS.length - 1);
  const low = Math.min(Math.floor(place), ERROR_STEPS.length - 2);
  return [0, 1, 2].map((c) => ERROR_STEPS[low][c] + (ERROR_STEPS[low + 1][c] - ERROR_STEPS[low][c]) * (place - low));
}

// Decodes a shape of the report.
function shapeOf(data) {
  const steps = new Uint16Array(bytesOf(data.positions).buffer);
  const faces = new Uint16Array(bytesOf(data.faces).buffer);
  const positions = Float32Array.from(steps, (step, k) => data.low_mm[k % 3] + data.step_mm * step);
  const normals = new Float32Array(positions.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const u = [0, 1, 2].map((k) => positions[b + k] - positions[a + k]);
    const v = [0, 1, 2].map((k) => positions[c + k] - positions[a + k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const corner of [a, b, c]) for (let k = 0; k < 3; k++) normals[corner + k] += n[k];
  }
  for (let v = 0; v < normals.length; v += 3) {
    const length = Math.hypot(normals[v], normals[v + 1], normals[v + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[v + k] /= length;
  }
  const errors = data.errors ? bytesOf(data.errors) : null;
  return { positions, normals, faces, errors };
}

// Returns a colour for each vertex: of its error, or the same for all.
function coloursOf(shape, plain) {
  const colours = new Float32Array(shape.positions.length);
  for (let v = 0; 3 * v < colours.length; v++) {
    colours.set(shape.errors && !plain ? errorColour(shape.errors[v] / 255) : plain || [200, 202, 200], 3 * v);
  }
  return colours;
}

// Middle and radius (mm) of a ball around a shape.
function ballOf(positions) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  positions.forEach((x, k) => {
    low[k % 3] = Math.min(low[k % 3], x);
    high[k % 3] = Math.max(high[k % 3], x);
  });
  const middle = low.map((x, k) => (x + high[k]) / 2);
  let radius = 1;
  for (let v = 0; v < positions.length; v += 3) {
    radius = Math.max(radius, Math.hypot(positions[v] - middle[0], positions[v + 1] - middle[1], positions[v + 2] - middle[2]));
  }
  return { middle, radius };
}

// Rows of the rotation that shows z upwards from a yaw and a pitch.
function rotationOf(yaw, pitch) {
  const [s, c, t, d] = [Math.sin(yaw), Math.cos(yaw), Math.sin(pitch), Math.cos(pitch)];
  return [[-s, c, 0], [-t * c, -t * s, d], [d * c, d * s, t]];
}

class GlPainter {
  static create(canvas) {
    const gl = canvas.getContext("webgl", { antialias: true });
    return gl && new GlPainter(gl);
  }

  constructor(gl) {
    this.gl = gl;
    this.buffers = new Map();
    const compile = (kind, text) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      return shader;
    };
    const program = (this.program = gl.createProgram());
    gl.attachShader(program, compile(gl.VERTEX_SHADER, `
      attribute vec3 position, normal, colour;
      uniform mat3 rotation;
      uniform vec3 middle;
      uniform vec2 scale;
      varying vec3 turned, shade;
      void main() {
        vec3 p = rotation * (position - middle);
        turned = rotation * normal;
        shade = colour / 255.0;
        gl_Position = vec4(p.xy * scale, -p.z * 0.001, 1.0);
      }`));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER, `
      precision mediump float;
      uniform vec3 light;
      varying vec3 turned, shade;
      void main() {
        vec3 n = normalize(turned);
        float towards = dot(n.z < 0.0 ? -n : n, light);
        gl_FragColor = vec4(min(shade * (0.45 + 0.6 * max(towards, 0.0)), 1.0), 1.0);
      }`));
    gl.linkProgram(program);
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.SCISSOR_TEST);
  }

  buffersOf(panel) {
    const gl = this.gl;
    const upload = (target, data) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(target, buffer);
      gl.bufferData(target, data, gl.STATIC_DRAW);
      return buffer;
    };
    if (!this.buffers.has(panel.colours)) {
      this.buffers.set(panel.colours, {
        position: upload(gl.ARRAY_BUFFER, panel.shape.positions),
        normal: upload(gl.ARRAY_BUFFER, panel.shape.normals),
        colour: upload(gl.ARRAY_BUFFER, panel.colours),
        faces: upload(gl.ELEMENT_ARRAY_BUFFER, panel.shape.faces),
      });
    }
    return this.buffers.get(panel.colours);
  }

  forget() {
    for (const buffers of this.buffers.values()) Object.values(buffers).forEach((buffer) => this.gl.deleteBuffer(buffer));
    this.buffers.clear();
  }

  paint(panels, rotation, paper) {
    const gl = this.gl;
    const uniform = (name) => gl.getUniformLocation(this.program, name);
    for (const panel of panels) {
      const { x, y, width, height, middle, scale } = panel;
      const bottom = gl.canvas.height - y - height;
      gl.viewport(x, bottom, width, height);
      gl.scissor(x, bottom, width, height);
      gl.clearColor(paper[0] / 255, paper[1] / 255, paper[2] / 255, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      const buffers = this.buffersOf(panel);
      for (const name of ["position", "normal", "colour"]) {
        const place = gl.getAttribLocation(this.program, name);
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
      }
      gl.uniformMatrix3fv(uniform("rotation"), false, [0, 1, 2].flatMap((k) => rotation.map((row) => row[k])));
      gl.uniform3fv(uniform("middle"), middle);
      gl.uniform2f(uniform("scale"), (2 * scale) / width, (2 * scale) / height);
      gl.uniform3fv(uniform("light"), LIGHT);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.faces);
      gl.drawElements(gl.TRIANGLES, panel.shape.faces.length, gl.UNSIGNED_SHORT, 0);
    }
  }
}

class PlainPainter {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
  }

  forget() {}

  paint(panels, rotation, paper) {
    for (const panel of panels) this.panel(panel, rotation, paper);
  }

  panel({ shape, colours, x, y, width, height, middle, scale }, rotation, paper) {
    const { positions, normals, faces } = shape;
    const image = this.context.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    pixels.fill(0xff000000 | (paper[2] << 16) | (paper[1] << 8) | paper[0]);
    const depths = new Float32Array(width * height).fill(-Infinity);
    const count = positions.length / 3;
    const [px, py, pz] = [new Float32Array(count), new Float32Array(count), new Float32Array(count)];
    const lit = new Float32Array(3 * count);
    const [r0, r1, r2] = rotation;
    for (let v = 0; v < count; v++) {
      const [a, b, c] = [positions[3 * v] - middle[0], positions[3 * v + 1] - middle[1], positions[3 * v + 2] - middle[2]];
      px[v] = width / 2 + scale * (r0[0] * a + r0[1] * b + r0[2] * c);
      py[v] = height / 2 - scale * (r1[0] * a + r1[1] * b + r1[2] * c);
      pz[v] = r2[0] * a + r2[1] * b + r2[2] * c;
      const [l, m, n] = [normals[3 * v], normals[3 * v + 1], normals[3 * v + 2]];
      const facing = r2[0] * l + r2[1] * m + r2[2] * n < 0 ? -1 : 1;
      const towards = facing * [r0, r1, r2].reduce((sum, r, k) => sum + LIGHT[k] * (r[0] * l + r[1] * m + r[2] * n), 0);
      const brightness = 0.45 + 0.6 * Math.max(towards, 0);
      for (let k = 0; k < 3; k++) lit[3 * v + k] = Math.min(colours[3 * v + k] * brightness, 255);
    }
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [faces[f], faces[f + 1], faces[f + 2]];
      const area = (px[b] - px[a]) * (py[c] - py[a]) - (px[c] - px[a]) * (py[b] - py[a]);
      if (area === 0) continue;
      const left = Math.max(0, Math.ceil(Math.min(px[a], px[b], px[c]) - 0.5));
      const right = Math.min(width - 1, Math.floor(Math.max(px[a], px[b], px[c]) - 0.5));
      const top = Math.max(0, Math.ceil(Math.min(py[a], py[b], py[c]) - 0.5));
      const bottom = Math.min(height - 1, Math.floor(Math.max(py[a], py[b], py[c]) - 0.5));
      for (let row = top; row <= bottom; row++) {
        for (let column = left; column <= right; column++) {
          const [dx, dy] = [column + 0.5 - px[a], row + 0.5 - py[a]];
          const u = (dx * (py[c] - py[a]) - dy * (px[c] - px[a])) / area;
          const v = (dy * (px[b] - px[a]) - dx * (py[b] - py[a])) / area;
          if (u < 0 || v < 0 || u + v > 1) continue;
          const w = 1 - u - v, at = row * width + column;
          const depth = w * pz[a] + u * pz[b] + v * pz[c];
          if (depth <= depths[at]) continue;
          depths[at] = depth;
          const colour = (k) => w * lit[3 * a + k] + u * lit[3 * b + k] + v * lit[3 * c + k];
          pixels[at] = 0xff000000 | (colour(2) << 16) | (colour(1) << 8) | colour(0);
        }
      }
    }
    this.context.putImageData(image, x, y);
  }
}

// Shows shapes side by side on a canvas, and turns them.
class ShapeView {
  constructor(stage) {
    this.stage = stage;
    this.canvas = stage.querySelector("canvas");
    // "#plain" in the address asks for the canvas without WebGL.
    this.painter = (location.hash !== "#plain" && GlPainter.create(this.canvas)) || new PlainPainter(this.canvas);
    [this.yaw, this.pitch, this.zoom] = [0.9, 0.45, 1];
    this.entries = [];
    this.turning = null;
    this.painted = 0;
    this.listen();
  }

  listen() {
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      this.turn(-0.01 * event.movementX, 0.01 * event.movementY);
    });
    canvas.addEventListener("wheel", (event) => {
      // Without a key the wheel scrolls the page.
      if (!event.ctrlKey && document.activeElement !== canvas) return;
      event.preventDefault();
      this.zoom = Math.min(8, Math.max(0.5, this.zoom * Math.exp(-0.002 * event.deltaY)));
      this.repaint();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (step) this.turn(...step);
      if (event.key === "+" || event.key === "-") this.zoom = Math.min(8, Math.max(0.5, this.zoom * (event.key === "+" ? 1.15 : 0.87)));
      if (step || event.key === "+" || event.key === "-") event.preventDefault(), this.repaint();
    });
    addEventListener("resize", () => this.repaint());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.repaint());
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(1.55, Math.max(-1.55, this.pitch + pitch));
    this.repaint();
  }

  // Shows [name, shape, plain colour or null] entries.
  show(entries) {
    this.painter.forget();
    this.entries = entries.map(([name, shape, plain]) => ({ name, shape, colours: coloursOf(shape, plain), ...ballOf(shape.positions) }));
    this.repaint();
  }

  repaint() {
    if (!this.pending) this.pending = requestAnimationFrame(() => this.paint());
  }

  paint() {
    this.pending = null;
    if (!this.entries.length || !this.stage.clientWidth) return;
    const style = getComputedStyle(this.stage);
    const paper = style.backgroundColor.match(/\d+/g).map(Number);
    const isNarrow = this.stage.clientWidth < 520;
    const [columns, rows] = isNarrow ? [1, this.entries.length] : [this.entries.length, 1];
    const cssHeight = isNarrow ? 260 * rows : 400;
    const limit = this.painter instanceof GlPainter ? 2 : 1;
    const ratio = Math.min(devicePixelRatio || 1, limit);
    const [width, height] = [Math.round(this.stage.clientWidth * ratio), Math.round(cssHeight * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) {
      [this.canvas.width, this.canvas.height] = [width, height];
      this.canvas.style.height = `${cssHeight}px`;
    }
    const [panelWidth, panelHeight] = [Math.floor(width / columns), Math.floor(height / rows)];
    // All are shown at one scale, around the middle of the true shape, which comes last.
    const { middle, radius } = this.entries[this.entries.length - 1];
    const scale = (this.zoom * 0.46 * Math.min(panelWidth, panelHeight)) / radius;
    const panels = this.entries.map((entry, k) => ({
      ...entry, middle, scale, width: panelWidth, height: panelHeight,
      x: isNarrow ? 0 : k * panelWidth, y: isNarrow ? k * panelHeight : 0,
    }));
    this.painter.paint(panels, rotationOf(this.yaw, this.pitch), paper);
    this.pixelsPerMm = scale / ratio;
    document.querySelector(".scale b").style.width = `${20 * this.pixelsPerMm}px`;
    const names = this.stage.querySelector("#names");
    names.replaceChildren(...panels.map((panel) => {
      const name = document.createElement("span");
      name.textContent = panel.name;
      [name.style.left, name.style.top] = [`${panel.x / ratio}px`, `${panel.y / ratio}px`];
      return name;
    }));
    this.painted++;
    if (this.turning !== null) {
      const now = performance.now();
      this.yaw += (now - this.turning) * 0.0008;
      this.turning = now;
      this.repaint();
    }
  }

  // Turns by itself until it is called again; returns whether it turns.
  spin() {
    this.turning = this.turning === null ? performance.now() : null;
    this.repaint();
    return this.turning !== null;
  }
}
