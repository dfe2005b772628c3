"""Painted surfaces: labels of objects, table and walls. All follow from seeds."""

import zlib

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter

# Pixels of a label per metre: finer than a pixel of the camera at 0.6 m, which is 1 mm.
DENSITY = 1500.0


def seeded(name, *more):
    """Returns a generator that a name decides."""
    return np.random.default_rng([zlib.crc32(name.encode()), *more])


def label(rng, size_m, colours, amount):
    """Draws a printed label: bands, blocks, words and small print. `amount` is the share of the usual print."""
    width, height = (max(24, int(DENSITY * edge)) for edge in size_m)
    base, second, ink = (ImageColor.getrgb(colour) for colour in colours)
    image = Image.new("RGB", (width, height), base)
    draw = ImageDraw.Draw(image)

    def place(w, h):
        x, y = rng.uniform(-0.1, 0.9) * width, rng.uniform(0.0, 0.9) * height
        return x, y, x + w, y + h

    if amount >= 1.0:
        y = rng.uniform(0.1, 0.6) * height
        draw.rectangle((0, y, width, y + rng.uniform(0.15, 0.3) * height), fill=second)
    area = width * height / DENSITY**2
    for _ in range(int(np.ceil(amount * 4 * area / 0.01))):
        w, h = rng.uniform(0.1, 0.4, 2) * min(width, height)
        shade = tuple(int(c) for c in rng.integers(20, 240, 3))
        shape = draw.ellipse if rng.random() < 0.5 else draw.rectangle
        shape(place(w, h), fill=[second, ink, shade][rng.integers(3)])
    for _ in range(int(np.ceil(amount * 5 * area / 0.01))):
        word = "".join(rng.choice(list("ABCDEFGHIKLMNOPRSTUVWXYZ"), rng.integers(3, 8)))
        font = ImageFont.load_default(size=float(rng.uniform(0.008, 0.03) * DENSITY))
        x, y, *_ = place(0, 0)
        draw.text((x, y), word, fill=[ink, second, base][rng.integers(2)], font=font)
    for _ in range(int(amount * 4 * area / 0.01)):
        x, y, *_ = place(0, 0)
        for line in range(int(rng.integers(3, 9))):
            draw.line((x, y + 4 * line, x + rng.uniform(0.1, 0.3) * width, y + 4 * line), fill=ink, width=2)
    return gaussian_filter(np.asarray(image, np.float32) / 255.0, (0.6, 0.6, 0))


def lookup(image, x, y):
    """Returns the colours at shares of an image's width and height."""
    rows = np.clip((y * image.shape[0]).astype(int), 0, image.shape[0] - 1)
    columns = np.clip((x * image.shape[1]).astype(int), 0, image.shape[1] - 1)
    return image[rows, columns]


class Painted:
    """Colours on the surface of an object, by position and normal in the object's coordinates."""

    def __init__(self, name, mesh, entry):
        rng = seeded(name)
        self.map, self.gloss = entry["map"], entry["gloss"]
        self.colours = np.array([ImageColor.getrgb(colour) for colour in entry["colours"]], np.float32) / 255.0
        points = np.asarray(mesh.vertices)
        # Axes along the smallest rectangle around the footprint.
        turns = np.radians(np.arange(90))
        areas = [np.prod(np.ptp(points[:, :2] @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]), axis=0)) for a in turns]
        a = turns[int(np.argmin(areas))]
        self.axes = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]], np.float32)
        turned = points @ self.axes
        self.low, self.size = turned.min(0), np.ptp(turned, axis=0)
        amount = entry.get("print", 1.0)
        x, y, z = self.size
        around = np.pi * (x + y) / 2.0
        edges = {"box": [(y, z), (y, z), (x, z), (x, z), (x, y), (x, y)], "cylinder": [(around, z), (x, y)], "plain": []}[self.map]
        self.images = [label(rng, edge, entry["colours"], amount) for edge in edges]
        self.waves = rng.normal(size=(12, 3)) * rng.uniform(60.0, 500.0, (12, 1))
        self.phases = rng.uniform(0.0, 2.0 * np.pi, 12)

    def albedo(self, points, normals):
        """Returns the colours, 0 to 1."""
        share = (points @ self.axes - self.low) / self.size
        normals = normals @ self.axes
        if self.map == "plain":
            mix = np.cos(points @ self.waves.T + self.phases).mean(1, keepdims=True)
            first = np.clip(0.5 + 1.2 * mix, 0.0, 1.0)
            result = self.colours[0] * first + self.colours[1] * (1.0 - first)
            return np.where(mix > 0.42, self.colours[2], result)
        if self.map == "cylinder":
            angle = np.arctan2(share[:, 1] - 0.5, share[:, 0] - 0.5) / (2.0 * np.pi) + 0.5
            side = lookup(self.images[0], angle, 1.0 - share[:, 2])
            cap = lookup(self.images[1], share[:, 0], share[:, 1])
            return np.where(np.abs(normals[:, 2:]) > 0.8, cap, side)
        axis = np.abs(normals).argmax(1)
        face = 2 * axis + (normals[np.arange(len(axis)), axis] > 0.0)
        result = np.empty((len(points), 3), np.float32)
        for k, image in enumerate(self.images):
            rest = [0, 1, 2]
            rest.remove(k // 2)
            chosen = face == k
            result[chosen] = lookup(image, share[chosen, rest[0]], 1.0 - share[chosen, rest[1]])
        return result


def surface(rng, colour, grain, edge=1024):
    """Draws a repeating surface such as wood or a painted wall: coarse and fine noise about a colour."""
    noise = sum(gaussian_filter(rng.normal(size=(edge, edge)), (s, s * grain), mode="wrap") * s * np.sqrt(grain) for s in (1.5, 6.0, 25.0))
    image = np.array(ImageColor.getrgb(colour), np.float32) / 255.0 * (1.0 + 0.12 * noise[..., None])
    return np.clip(image, 0.0, 1.0).astype(np.float32)


def printed(rng, image, count, metres):
    """Puts posters or papers on a surface whose edge has a length in metres."""
    edge = image.shape[0]
    for _ in range(count):
        w, h = rng.uniform(0.1, 0.3, 2)
        colours = ["#%02x%02x%02x" % tuple(rng.integers(30, 240, 3)) for _ in range(3)]
        drawn = Image.fromarray((255 * label(rng, (w, h), colours, 1.0)).astype(np.uint8))
        drawn = np.asarray(drawn.resize((int(w / metres * edge), int(h / metres * edge)), Image.Resampling.BOX)) / 255.0
        y, x = (int(rng.uniform(0.0, edge - n)) for n in drawn.shape[:2])
        image[y : y + drawn.shape[0], x : x + drawn.shape[1]] = drawn
    return image
