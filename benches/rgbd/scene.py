"""What the camera sees: rays of Open3D against a room, an object, and the hand, gripper or board before it."""

import numpy as np
import open3d as o3d
from paint import Painted, printed, surface
from suite import SUITE, load_mesh

WIDTH, HEIGHT = 640, 480
INTRINSICS = np.array([[615.0, 0.0, 318.5], [0.0, 615.0, 241.5], [0.0, 0.0, 1.0]])
# Projector of the depth camera, in the camera's coordinates.
PROJECTOR = np.array([0.075, 0.0, 0.0])
BACKGROUND, OBJECT, COVER = 0, 1, 2
SKIN = np.array([0.78, 0.56, 0.44])
METAL = np.array([0.30, 0.31, 0.33])
FINGER_M = 0.0085
TABLE_M = (0.8, 0.6)
WALL_M = 1.9


def directions(u, v):
    """Returns the rays of pixels in the camera's coordinates; their z is 1, so that distances along them are depths."""
    k = INTRINSICS
    return np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1).astype(np.float32)


def grid(window, factor=1):
    """Returns the pixels (u, v) of a window (left, top, right, bottom), each split into factor x factor."""
    left, top, right, bottom = window
    part = (np.arange(factor) + 0.5) / factor - 0.5
    u = (np.arange(left, right)[:, None] + part).ravel()
    v = (np.arange(top, bottom)[:, None] + part).ravel()
    return np.meshgrid(u, v)


class Layer:
    """Meshes in one frame of coordinates."""

    def __init__(self, meshes):
        vertices = [np.asarray(mesh.vertices, np.float32) for mesh in meshes]
        triangles = [np.asarray(mesh.triangles) for mesh in meshes]
        first = np.cumsum([0, *(len(part) for part in vertices)])[:-1]
        self.owner = np.repeat(np.arange(len(meshes)), [len(part) for part in triangles])
        self.triangles = np.concatenate([part + start for part, start in zip(triangles, first, strict=True)]).astype(np.uint32)
        self.normals = np.concatenate([np.asarray(mesh.vertex_normals, np.float32) for mesh in meshes])
        self.scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self.scene.add_triangles(o3d.core.Tensor(np.concatenate(vertices)), o3d.core.Tensor(self.triangles))

    def rays(self, origin, rays):
        whole = np.empty((*rays.shape[:-1], 6), np.float32)
        whole[..., :3], whole[..., 3:] = origin, rays
        return self.scene.cast_rays(o3d.core.Tensor(whole))

    def cast(self, origin, rays, nearer_than=np.inf):
        """Returns which rays hit before a distance; and of those the distance, mesh and smooth normal."""
        found = self.rays(origin, rays)
        distance = found["t_hit"].numpy()
        hit = distance < nearer_than
        triangle = found["primitive_ids"].numpy()[hit]
        uv = found["primitive_uvs"].numpy()[hit]
        corners = self.normals[self.triangles[triangle]]
        normals = corners[:, 0] * (1.0 - uv[:, :1] - uv[:, 1:]) + corners[:, 1] * uv[:, :1] + corners[:, 2] * uv[:, 1:]
        normals /= np.maximum(length(normals), 1e-9)[:, None]
        return hit, distance[hit], self.owner[triangle], normals

    def distance(self, origin, rays):
        """Returns the distance of the first hit of each ray."""
        return self.rays(origin, rays)["t_hit"].numpy()

    def hides(self, points, light, margin_m=0.006):
        """Returns which points a light cannot reach."""
        rays = points - np.asarray(light, np.float32)
        return self.distance(light, rays) < 1.0 - margin_m / np.maximum(length(rays), 1e-3)


def length(vectors):
    """Returns the lengths of vectors; faster than NumPy's norm."""
    return np.sqrt(np.einsum("...c,...c->...", vectors, vectors))


def box(size, centre=(0.0, 0.0, 0.0)):
    """Returns a box with flat faces, whose middle lies at a place."""
    mesh = o3d.geometry.TriangleMesh.create_box(*size)
    mesh.translate(np.asarray(centre) - np.asarray(size) / 2.0)
    return flat(mesh)


def flat(mesh):
    """Gives each triangle its own corners, so that its normal is that of the face."""
    vertices = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)].reshape(-1, 3)
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(np.arange(len(vertices)).reshape(-1, 3)))
    mesh.compute_vertex_normals()
    return mesh


def capsule(start, end, radius):
    """Returns a rod with round ends."""
    axis = end - start
    length = np.linalg.norm(axis)
    mesh = o3d.geometry.TriangleMesh.create_sphere(radius, 8)
    vertices = np.asarray(mesh.vertices).copy()
    vertices[vertices[:, 2] > 1e-9, 2] += length
    z = axis / max(length, 1e-9)
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.8 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    mesh.vertices = o3d.utility.Vector3dVector(vertices @ np.stack([x, np.cross(z, x), z]) + start)
    mesh.compute_vertex_normals()
    return mesh


class Room:
    """Table with other objects on it, floor and walls."""

    def __init__(self, seed, own, camera, free_m):
        rng = np.random.default_rng([seed, 2])
        tones = ["#8a6a48", "#b09878", "#6a6660", "#a8a49c", "#5a4434"]
        walls = ["#b8b4a8", "#90a0a8", "#c0b090", "#8c8c94"]
        self.images = [
            printed(rng, surface(rng, tones[rng.integers(len(tones))], 6), 7, 2.0),
            surface(rng, "#70685c", 1),
            printed(rng, surface(rng, walls[rng.integers(len(walls))], 1), 12, 4.0),
        ]
        meshes = [box((2 * TABLE_M[0], 2 * TABLE_M[1], 0.03), (0.0, 0.0, -0.015)), box((8.0, 8.0, 0.02), (0.0, 0.0, -0.76))]
        for axis in range(2):
            for side in (-1.0, 1.0):
                size, centre = [8.0, 8.0, 8.0], [0.0, 0.0, 0.0]
                size[axis], centre[axis] = 0.02, side * WALL_M
                meshes.append(box(size, centre))
        self.things = []
        names = [name for name in SUITE["objects"] if name != own]
        # The others stand aside and behind, where they neither touch nor hide the object.
        toward = camera[:2] / np.linalg.norm(camera[:2])
        across = np.array([-toward[1], toward[0]])
        spots = [(-0.24, -0.26), (-0.30, 0.02), (-0.22, 0.28), (0.02, 0.34)]
        for name, (ahead, aside) in zip(rng.choice(names, len(spots), replace=False), spots, strict=True):
            mesh = load_mesh(name)
            paint = Painted(name, mesh, SUITE["objects"][name])
            low, high = np.asarray(mesh.vertices).min(0), np.asarray(mesh.vertices).max(0)
            turn = rng.uniform(-np.pi, np.pi)
            pose = np.eye(4)
            pose[:3, :3] = o3d.geometry.get_rotation_matrix_from_axis_angle([0.0, 0.0, turn])
            extra = max(0.0, np.linalg.norm((high - low)[:2]) / 2.0 + free_m - 0.30)
            place = (1.0 + extra / 0.3) * (ahead * toward + aside * across)
            pose[:3, 3] = [*place, 0.0] - pose[:3, :3] @ [*((low + high) / 2.0)[:2], low[2]]
            mesh.transform(pose)
            self.things.append((paint, np.linalg.inv(pose)))
            meshes.append(mesh)
        self.layer = Layer(meshes)

    def albedo(self, points, normals, ids):
        """Returns colour and gloss of points by the mesh to which they belong."""
        result, gloss = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
        for index in np.unique(ids):
            chosen = ids == index
            at, facing = points[chosen], normals[chosen]
            if index < 6:
                image = self.images[min(index, 2)]
                metres = (2.0, 2.0, 4.0)[min(index, 2)]
                axes = [0, 1] if index < 2 else [1 if index < 4 else 0, 2]
                cells = np.floor(at[:, axes] / metres * image.shape[0] + image.shape[0] / 2.0).astype(int) % image.shape[0]
                result[chosen] = image[cells[:, 1], cells[:, 0]]
                gloss[chosen] = 0.05 if index == 0 else 0.0
            else:
                paint, pose = self.things[index - 6]
                result[chosen] = paint.albedo(at @ pose[:3, :3].T + pose[:3, 3], facing @ pose[:3, :3].T)
                gloss[chosen] = paint.gloss
        return result, gloss


class Hand:
    """Fingers and a thumb that lie on the surface of an object, a palm and a forearm. The object may turn within them."""

    def __init__(self, seed, layer, centre, radius, camera, reach):
        rng = np.random.default_rng([seed, 3])
        self.layer, self.centre, self.radius = layer, centre, radius
        self.camera, self.reach = camera, reach
        side = rng.choice([-1.0, 1.0])
        # The arm comes from one side and from below, a little from behind, in the camera's axes.
        approach = np.array([-side * 0.85, -0.35, -0.25 + rng.uniform(-0.1, 0.1)])
        self.approach = approach / np.linalg.norm(approach)
        spread = np.array([0.0, 1.0, 0.0]) - self.approach * self.approach[1]
        self.spread = spread / np.linalg.norm(spread)
        self.tone = SKIN * rng.uniform(0.6, 1.05)
        self.radii = None

    def meshes(self, world_from_object, grip, wobble):
        turn = self.camera[:3, :3] @ o3d.geometry.get_rotation_matrix_from_axis_angle(wobble)
        a, s = turn @ self.approach, turn @ self.spread
        # The fingers bend towards the camera.
        w = np.cross(s, a)
        if w @ self.camera[:3, 2] > 0.0:
            w = -w
        c = world_from_object[:3, :3] @ self.centre + world_from_object[:3, 3]
        inverse = np.linalg.inv(world_from_object)
        offsets = np.array([-0.033, -0.011, 0.011, 0.033]) * np.clip(self.radius / 0.09, 0.6, 1.0)
        angles = [np.radians(np.linspace(12.0, self.reach, 8))] * 4 + [np.radians(np.linspace(-12.0, -self.reach - 20.0, 8))]
        offsets = np.append(offsets, 0.0)
        wide = np.radians([-8.0, 0.0, 8.0])
        theta = np.stack(angles)[:, :, None] + wide
        d = -a * np.cos(theta)[..., None] + w * np.sin(theta)[..., None]
        roots = c + offsets[:, None] * s
        start = roots[:, None, None, :] + 0.4 * d
        hits = self.layer.distance(start @ inverse[:3, :3].T + inverse[:3, 3], -d @ inverse[:3, :3].T)
        radii = 0.4 - hits
        radii[~np.isfinite(radii)] = 0.02
        radii = np.clip(radii.max(-1), 0.02, None)
        # Fingers move smoothly, but do not sink in.
        self.radii = radii if self.radii is None else np.maximum(radii, 0.6 * self.radii + 0.4 * radii)
        away = -a * 0.7 * (1.0 - grip) + 0.0
        joints = roots[:, None] + (self.radii + FINGER_M + 0.03 * (1.0 - grip))[..., None] * d[:, :, 1] + away
        made = [capsule(joints[i, j], joints[i, j + 1], FINGER_M) for i in range(5) for j in range(7)]
        behind = self.radii[:, 0].max() + 0.02
        knuckles = roots[:4] - a * behind + away
        wrist = c - a * (behind + 0.07) + away
        made += [capsule(knuckle, wrist, 0.014) for knuckle in knuckles]
        made += [capsule(knuckle, joints[i, 0], 0.010) for i, knuckle in enumerate(knuckles)]
        made += [capsule(joints[4, 0], wrist, 0.012), capsule(wrist, wrist - 0.5 * (a + 0.25 * self.camera[:3, 2]), 0.030)]
        return made, [self.tone] * len(made)


class Gripper:
    """Two fingers, a palm and an arm, which hold an object from above and turn with it."""

    def __init__(self, vertices, rest):
        # Upright in the world, about the object as it stands.
        points = vertices @ rest[:3, :3].T + rest[:3, 3]
        low, high = points[:, 2].min(), points[:, 2].max()
        depth = min(0.045, 0.6 * (high - low))
        upper = points[points[:, 2] > high - depth - 0.01]
        middle = (upper[:, :2].min(0) + upper[:, :2].max(0)) / 2.0
        turns = np.radians(np.arange(0, 180, 3))
        spans = [np.ptp(upper[:, :2] @ [np.cos(t), np.sin(t)]) for t in turns]
        turn = turns[int(np.argmin(spans))]
        self.grasp = np.eye(4)
        self.grasp[:3, :3] = o3d.geometry.get_rotation_matrix_from_axis_angle([0.0, 0.0, turn])
        self.grasp[:3, 3] = [*middle, high]
        across = (upper[:, :2] - middle) @ [np.cos(turn), np.sin(turn)]
        self.sides, self.depth, self.rest = (across.min(), across.max()), depth, rest

    def meshes(self, world_from_object, grip, _):
        pose = world_from_object @ np.linalg.inv(self.rest) @ self.grasp
        open_m, up = 0.025 * (1.0 - grip), np.array([0.0, 0.0, 0.5 * (1.0 - grip)])
        length = self.depth + 0.05
        made = [
            box((0.010, 0.020, length), (self.sides[0] - open_m - 0.005, 0.0, 0.5 * length - self.depth)),
            box((0.010, 0.020, length), (self.sides[1] + open_m + 0.005, 0.0, 0.5 * length - self.depth)),
            box((max(0.11, self.sides[1] - self.sides[0] + 0.05), 0.05, 0.04), ((self.sides[0] + self.sides[1]) / 2.0, 0.0, 0.07)),
            capsule(np.array([0.0, 0.0, 0.11]), np.array([0.0, 0.0, 0.7]), 0.035),
        ]
        for mesh in made:
            mesh.translate(up).transform(pose)
        return made, [METAL * 0.8, METAL * 0.8, METAL, METAL * 1.8]


class Cover:
    """Board or open hand that passes before the camera and hides the object."""

    def __init__(self, seed, kind, camera, distance_m, extent_m):
        rng = np.random.default_rng([seed, 4])
        self.camera, self.kind = camera, kind
        self.near_m = 0.5 * distance_m
        self.size = 2.0 * extent_m * 0.5 + 0.06
        self.side = rng.choice([-1.0, 1.0])
        self.tone = SKIN * rng.uniform(0.6, 1.05) if kind == "hand" else rng.uniform(0.2, 0.8, 3)

    def meshes(self, cover):
        """`cover` grows from 0 over 1, before the object, to 2."""
        if cover <= 0.0 or cover >= 2.0:
            return [], []
        # Out of the picture at both ends.
        shift = np.array([self.side * (cover - 1.0) * (0.6 * self.near_m + self.size), 0.0, self.near_m])
        half = self.size / 2.0
        if self.kind == "hand":
            made = [capsule(np.array([x, half, 0.0]), np.array([x, -half, 0.0]), 0.024) for x in np.arange(-half, half + 0.02, 0.032)]
            made.append(capsule(np.array([0.0, half, 0.0]), np.array([0.3, half + 0.3, 0.05]), 0.045))
        else:
            made = [box((self.size, self.size, 0.006))]
        for mesh in made:
            mesh.translate(shift).transform(self.camera)
        return made, [self.tone] * len(made)


class View:
    """Renders the frames of one sequence without noise."""

    def __init__(self, entry, motion, mesh):
        self.motion = motion
        camera = motion.world_from_camera[0]
        vertices = np.asarray(mesh.vertices)
        centre = (vertices.min(0) + vertices.max(0)) / 2.0
        radius = np.linalg.norm(vertices - centre, axis=1).max()
        self.vertices = vertices
        self.paint = Painted(entry["object"], mesh, SUITE["objects"][entry["object"]])
        self.object = Layer([mesh])
        self.room = Room(entry["seed"], entry["object"], camera[:3, 3], np.linalg.norm(np.ptp(vertices, axis=0)[:2]) / 2.0 + 0.05)
        self.holder = None
        if motion.holder == "gripper":
            self.holder = Gripper(vertices, motion.world_from_object[0])
        elif motion.holder == "hand":
            self.holder = Hand(entry["seed"], self.object, centre, radius, camera, entry.get("reach_deg", 75.0))
        self.cover = None
        if motion.cover.any():
            covered = motion.world_from_object[motion.cover == 1.0] @ np.append(centre, 1.0)
            seen = covered[:, :3] @ camera[:3, :3] - camera[:3, 3] @ camera[:3, :3]
            spread = np.abs(0.5 * entry["distance_m"] * seen[:, :2] / seen[:, 2:]).max()
            self.cover = Cover(entry["seed"], entry["by"], camera, entry["distance_m"], 2.0 * spread + 1.2 * radius)
        rng = np.random.default_rng([entry["seed"], 5])
        light = camera[:3, :3] @ np.array([rng.uniform(-0.7, 0.7), -0.9, -0.6])
        self.light = (light / np.linalg.norm(light)).astype(np.float32)
        self.fixed = bool(np.ptp(motion.world_from_camera, axis=0).max() < 1e-12)
        self.kept = None

    def background(self, camera):
        """Returns colours, depth, normals, points, shadows and mirrored light of the room; they are kept while the camera stands still."""
        if self.kept is not None and self.fixed:
            return self.kept
        eye, turn = camera[:3, 3].astype(np.float32), camera[:3, :3].astype(np.float32)
        whole = (0, 0, WIDTH, HEIGHT)
        rays = directions(*grid(whole)) @ turn.T
        _, depth, color, normals, mirror = self.room_seen(eye, rays)
        if self.fixed:
            color = self.room_seen(eye, directions(*grid(whole, 2)) @ turn.T)[2].reshape(HEIGHT, 2, WIDTH, 2, 3).mean((1, 3))
        points = eye + rays * depth[..., None]
        shadow = self.room.layer.hides(points, eye + turn @ PROJECTOR.astype(np.float32))
        self.kept = color, depth, normals, points, shadow, mirror
        return self.kept

    def room_seen(self, eye, rays):
        """Returns hits, depth, colours, normals and mirrored light of the room, which is closed."""
        shape = rays.shape[:-1]
        rays = rays.reshape(-1, 3)
        hit, distance, ids, normals = self.room.layer.cast(eye, rays)
        albedo, gloss = self.room.albedo(eye + rays[hit] * distance[:, None], normals, ids)
        depth, color, facing, mirror = (
            np.full(len(rays), np.inf, np.float32),
            *(np.zeros((len(rays), 3), np.float32) for _ in range(2)),
            np.zeros(len(rays), np.float32),
        )
        depth[hit], facing[hit] = distance, normals
        color[hit], mirror[hit] = self.lit(albedo, gloss, normals, rays[hit])
        return hit, depth.reshape(shape), color.reshape(*shape, 3), facing.reshape(*shape, 3), mirror.reshape(shape)

    def lit(self, albedo, gloss, normals, rays):
        """Returns colours under one distant light and light from everywhere, and the strength of the mirrored light."""
        view = -rays / length(rays)[:, None]
        facing = normals * np.where(np.einsum("nc,nc->n", normals, view) < 0.0, -1.0, 1.0).astype(np.float32)[:, None]
        half = view + self.light
        half /= length(half)[:, None]
        mirror = gloss * np.clip(np.einsum("nc,nc->n", facing, half), 0.0, None) ** 40
        return np.clip(albedo * (0.45 + 0.6 * np.clip(facing @ self.light, 0.0, None))[:, None] + mirror[:, None], 0.0, 1.0), mirror

    def frame(self, index):
        """Returns colours, depth, cosine to the view, mirrored light, labels, shadow of the projector, and the object's pixels without what covers it."""
        motion = self.motion
        camera, pose = motion.world_from_camera[index], motion.world_from_object[index]
        eye, turn = camera[:3, 3].astype(np.float32), camera[:3, :3].astype(np.float32)
        light = eye + turn @ PROJECTOR.astype(np.float32)
        color, depth, normals, points, shadow, mirror = (part.copy() for part in self.background(camera))
        labels = np.full(depth.shape, BACKGROUND, np.uint8)
        made, tones = [], []
        if self.holder is not None:
            made, tones = self.holder.meshes(pose, motion.grip[index], motion.wobble[index])
        if self.cover is not None:
            more, others = self.cover.meshes(motion.cover[index])
            made, tones = made + more, tones + others
        movers, tones = Layer(made) if made else None, np.array(tones, np.float32)
        inverse = np.linalg.inv(pose).astype(np.float32)
        back, origin = inverse[:3, :3], inverse[:3, :3] @ eye + inverse[:3, 3]

        def draw(rays, depth, color, normals, mirror, labels):
            """Draws what lies before the background; all arguments but the rays are changed."""
            own = rays @ back.T
            hit, distance, _, facing = self.object.cast(origin, own, depth)
            albedo = self.paint.albedo(origin + own[hit] * distance[:, None], facing).astype(np.float32)
            facing = facing @ back
            color[hit], mirror[hit] = self.lit(albedo, np.full(len(albedo), self.paint.gloss, np.float32), facing, rays[hit])
            depth[hit], normals[hit], labels[hit] = distance, facing, OBJECT
            if movers is not None:
                over, distance, owner, facing = movers.cast(eye, rays, depth)
                color[over], mirror[over] = self.lit(tones[owner], np.full(len(owner), 0.05, np.float32), facing, rays[over])
                depth[over], normals[over], labels[over] = distance, facing, COVER
            return int(hit.sum())

        camera_from_object = np.linalg.inv(camera) @ pose
        window = bounds(self.vertices @ camera_from_object[:3, :3].T + camera_from_object[:3, 3])
        whole = window
        if made:
            others = bounds((np.concatenate([np.asarray(mesh.vertices) for mesh in made]) - eye) @ turn)
            whole = (*np.minimum(window[:2], others[:2]), *np.maximum(window[2:], others[2:]))
        # Colours of the object with four rays a pixel.
        part = np.s_[window[1] : window[3], window[0] : window[2]]
        fine = [np.repeat(np.repeat(image[part], 2, 0), 2, 1) for image in (depth, color, normals, mirror, labels)]
        draw(directions(*grid(window, 2)) @ turn.T, *fine)
        smooth = fine[1].reshape(window[3] - window[1], 2, window[2] - window[0], 2, 3).mean((1, 3))
        outer = np.s_[whole[1] : whole[3], whole[0] : whole[2]]
        rays = directions(*grid(whole)) @ turn.T
        alone = draw(rays, *(image[outer] for image in (depth, color, normals, mirror, labels)))
        color[part] = smooth
        new = labels != BACKGROUND
        points[outer] = eye + rays * depth[outer][..., None]
        # The shadow of the room on itself is known; that of object and holder falls on everything.
        shadow[new] = self.room.layer.hides(points[new], light)
        shadow |= self.object.hides(points @ back.T + inverse[:3, 3], back @ light + inverse[:3, 3])
        if movers is not None:
            shadow |= movers.hides(points, light)
        rays = points - eye
        cosine = np.abs(np.einsum("vuc,vuc->vu", normals, rays)) / np.maximum(length(rays), 1e-9)
        return color, depth, cosine, mirror, labels, shadow, alone


def bounds(points):
    """Returns the window of the picture that points in the camera's coordinates span: the whole one if some lie behind the camera."""
    if (points[:, 2] < 0.05).any():
        return 0, 0, WIDTH, HEIGHT
    pixels = points @ INTRINSICS.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    low, high = np.floor(pixels.min(0)).astype(int) - 1, np.ceil(pixels.max(0)).astype(int) + 2
    size = np.array([WIDTH, HEIGHT])
    return (*(int(x) for x in np.clip(low, 0, size)), *(int(x) for x in np.clip(high, 0, size)))
