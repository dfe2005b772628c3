"""Faults of a camera for colours and depth by structured light, and of a segmenter."""

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, maximum_filter, minimum_filter
from scene import HEIGHT, INTRINSICS, OBJECT, PROJECTOR, WIDTH

# Levels of disparity per pixel.
DISPARITY_LEVELS = 8.0
# Deviation of the pixel whose depth is measured.
JITTER_PX = 0.7
FURTHEST_M = 4.0
GRAZING = np.cos(np.radians(75.0))
DARK = 0.10
MIRROR = 0.18
EDGE_M = 0.02
NOISE_LEVELS = 2.5
EXPOSURE = 0.05


def field(rng, sigma, shape=(HEIGHT, WIDTH)):
    """Returns smooth noise with unit deviation."""
    if sigma >= 4.0:
        # Smooth fields need no more than every other pixel.
        small = field(rng, sigma / 2.0, ((shape[0] + 1) // 2, (shape[1] + 1) // 2))
        return np.repeat(np.repeat(small, 2, 0), 2, 1)[: shape[0], : shape[1]]
    noise = gaussian_filter(rng.standard_normal(shape, dtype=np.float32), sigma, mode="wrap")
    return noise * (2.0 * np.sqrt(np.pi) * sigma)


class Sensor:
    """Noise that depends on earlier frames only through slow fields."""

    def __init__(self, seed, frames):
        self.rng = np.random.default_rng([seed, 6])
        self.edge = field(self.rng, 6.0)
        self.weak = field(self.rng, 6.0)
        drift = np.cumsum(self.rng.normal(size=frames))
        self.exposure = 1.0 + EXPOSURE * np.sin(2.0 * np.pi * np.arange(frames) / 210.0 + drift[-1])
        self.v, self.u = np.mgrid[:HEIGHT, :WIDTH]

    def color(self, color, index):
        """Returns an image with 8 bits: a lens' blur, exposure and noise."""
        image = 255.0 * self.exposure[index] * gaussian_filter(color.astype(np.float32), (0.5, 0.5, 0.0))
        image += NOISE_LEVELS * self.rng.standard_normal(image.shape, dtype=np.float32)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def depth(self, depth, color, cosine, mirror, shadow):
        """Returns depth in millimetres with 16 bits; 0 where the camera would not see any."""
        rng = self.rng
        self.weak = 0.9 * self.weak + np.sqrt(1.0 - 0.9**2) * field(rng, 6.0)
        depth = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
        # Edges are ragged, for depth is that of a pixel beside.
        rows = np.clip(np.rint(self.v + JITTER_PX * field(rng, 1.0)), 0, HEIGHT - 1).astype(int)
        columns = np.clip(np.rint(self.u + JITTER_PX * field(rng, 1.0)), 0, WIDTH - 1).astype(int)
        z = depth[rows, columns]
        edge = maximum_filter(z, 3) - minimum_filter(z, 3) > EDGE_M
        # Of the pixels at edges most are empty, and some lie between both surfaces.
        kind = rng.random(z.shape, dtype=np.float32)
        between = edge & (kind < 0.04)
        z[between] += (rng.random(z.shape, dtype=np.float32) * (maximum_filter(z, 3) - z))[between]
        sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2
        noise = np.sqrt(0.5) * (rng.standard_normal(z.shape, dtype=np.float32) + field(rng, 1.2))
        z = np.maximum(z + sigma * noise, 1e-3)
        focal_m = INTRINSICS[0, 0] * PROJECTOR[0]
        z = focal_m / np.maximum(np.rint(DISPARITY_LEVELS * focal_m / z), 1.0) * DISPARITY_LEVELS
        dark = color.mean(-1) < DARK
        lost = shadow[rows, columns] | (cosine[rows, columns] < GRAZING) | (depth[rows, columns] > FURTHEST_M)
        lost |= edge & (kind > 0.45)
        lost |= dark & (self.weak > 0.3)
        lost |= (mirror > MIRROR) & (self.weak > -0.3)
        # A few specks anywhere.
        lost |= field(rng, 1.2) > 3.6
        z[lost] = 0.0
        return np.rint(1e3 * z).astype(np.uint16)

    def mask(self, labels):
        """Returns the object's pixels as a segmenter would: the edge is off by 1 to 2 pixels, smoothly along it."""
        self.edge = 0.8 * self.edge + 0.6 * field(self.rng, 6.0)
        own = labels == OBJECT
        if not own.any():
            return own
        inside = distance_transform_edt(own) - 0.5
        outside = distance_transform_edt(~own) - 0.5
        return np.where(own, inside, -outside) > np.clip(0.9 * self.edge, -2.0, 2.0)
