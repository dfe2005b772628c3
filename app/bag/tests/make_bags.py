"""Writes the bags in data/ with rosbags and mcap, and beside them the values that rosbags and OpenCV decode.

    pip install rosbags==0.11.9 mcap==1.6.0 numpy==2.4.6 opencv-python-headless==5.0.0.93
    python make_bags.py

The Rust tests read the files and need no Python. `--large FOLDER` writes bags of 1,000 frames of 640 x 480 pixels for measurements of speed.
"""

import argparse
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
DATA = Path(__file__).parent / "data"
WIDTH, HEIGHT, FRAMES = 16, 12, 4
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_333_333
COLOR = "/camera/color/image_raw"
DEPTH = "/camera/aligned_depth_to_color/image_raw"
INFO = "/camera/aligned_depth_to_color/camera_info"
MASKS = "/object/mask"
K = [14.0, 0.0, 7.3, 0.0, 14.5, 5.6, 0.0, 0.0, 1.0]
D = [-0.12, 0.03, 0.002, -0.001, 0.01]


def make(type_name, *args, **kwargs):
    return STORE.types[type_name](*args, **kwargs)


def header(stamp_ns, frame):
    time = make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def image(stamp_ns, encoding, pixels, frame="camera_color_optical_frame", padding=0, big=False):
    pixels = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
    rows = [row.tobytes() + b"\xee" * padding for row in pixels]
    data = np.frombuffer(b"".join(rows), np.uint8)
    height, width = pixels.shape[:2]
    head = header(stamp_ns, frame)
    return make("sensor_msgs/msg/Image", header=head, height=height, width=width, encoding=encoding, is_bigendian=int(big),
                step=len(rows[0]), data=data)


def compressed(stamp_ns, form, data):
    head = header(stamp_ns, "camera_color_optical_frame")
    return make("sensor_msgs/msg/CompressedImage", header=head, format=form, data=np.frombuffer(data, np.uint8))


def info(stamp_ns, model="plumb_bob", d=D, width=WIDTH, height=HEIGHT, k=K):
    p = [k[0], 0, k[2], 0, 0, k[4], k[5], 0, 0, 0, 1, 0]
    roi = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return make("sensor_msgs/msg/CameraInfo", header=header(stamp_ns, "camera_color_optical_frame"), height=height, width=width,
                distortion_model=model, d=np.array(d, float), k=np.array(k, float), r=np.eye(3).ravel(), p=np.array(p, float),
                binning_x=0, binning_y=0, roi=roi)


def joints(stamp_ns, values):
    position = np.array(list(values.values()), float)
    return make("sensor_msgs/msg/JointState", header=header(stamp_ns, ""), name=list(values), position=position,
                velocity=np.array([]), effort=np.array([]))


def transform(stamp_ns, parent, child, xyz, xyzw):
    t = make("geometry_msgs/msg/Vector3", *map(float, xyz))
    q = make("geometry_msgs/msg/Quaternion", *map(float, xyzw))
    return make("geometry_msgs/msg/TransformStamped", header=header(stamp_ns, parent), child_frame_id=child,
                transform=make("geometry_msgs/msg/Transform", translation=t, rotation=q))


def transforms(*list_of):
    return make("tf2_msgs/msg/TFMessage", transforms=list(list_of))


def pose(stamp_ns, frame, xyz, xyzw):
    position = make("geometry_msgs/msg/Point", *map(float, xyz))
    orientation = make("geometry_msgs/msg/Quaternion", *map(float, xyzw))
    return make("geometry_msgs/msg/PoseStamped", header=header(stamp_ns, frame),
                pose=make("geometry_msgs/msg/Pose", position=position, orientation=orientation))


def camera_at(seconds):
    """map from camera_link: it moves along x and turns about z at constant speeds."""
    angle = 0.8 * seconds
    return [0.1 + 0.3 * seconds, 0.2, 0.3], [0, 0, np.sin(angle / 2), np.cos(angle / 2)]


# camera_link from the optical frame.
OPTICAL = ([0.01, 0.02, 0.0], [-0.5, 0.5, -0.5, 0.5])


def matrix(xyz, xyzw):
    x, y, z, w = xyzw
    out = np.eye(4)
    out[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                   [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                   [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    out[:3, 3] = xyz
    return out


def pictures(k, width=WIDTH, height=HEIGHT):
    v, u = np.mgrid[:height, :width]
    color = np.stack([(15 * u + 9 * k) % 256, (20 * v + u) % 256, (u * v + 40 * k) % 256], axis=-1).astype(np.uint8)
    depth = (500 + 10 * u + 7 * v + 3 * k).astype(np.uint16)
    depth[3, 4] = 0
    mask = (((u - 8) ** 2 + (v - 6) ** 2) < 16).astype(np.uint8) * 255
    return color, depth, mask


def messages():
    """Messages of the RGB-D bag: time of recording, topic, message."""
    out = [(START_NS, "/tf_static", transforms(transform(START_NS, "camera_link", "camera_color_optical_frame", *OPTICAL)))]
    for k in range(FRAMES):
        stamp = START_NS + k * PERIOD_NS
        color, depth, mask = pictures(k)
        # Colours are recorded before depth in even frames and behind it in odd ones.
        late = 9_000_000 if k % 2 else 4_000_000
        out.append((stamp + late, COLOR, image(stamp + 3_000_000, "rgb8", color)))
        out.append((stamp + 6_000_000, DEPTH, image(stamp, "16UC1", depth)))
        out.append((stamp + 6_100_000, INFO, info(stamp)))
        out.append((stamp + 20_000_000, MASKS, image(stamp + 3_000_000, "mono8", mask)))
        out.append((stamp + 7_000_000, "/object/pose", pose(stamp, "camera_color_optical_frame", [0.1, 0.2, 0.5 + 0.01 * k], [0, 0, 0, 1])))
    for k in range(-1, 6):
        stamp = START_NS + k * 20_000_000
        out.append((stamp + 1_000_000, "/tf", transforms(transform(stamp, "map", "camera_link", *camera_at(k * 0.02)))))
        out.append((stamp + 1_500_000, "/joint_states", joints(stamp, {"finger": 0.5 + k * 0.02, "thumb": -0.1 * k * 0.02})))
        out.append((stamp + 1_600_000, "/chatter", make("std_msgs/msg/String", data="hello")))
    return sorted(out, key=lambda entry: entry[0])


def write(path, list_of, storage, mode=CompressionMode.NONE):
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for log_ns, topic, message in list_of:
            name = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, name, typestore=STORE)
            writer.write(topics[topic], log_ns, STORE.serialize_cdr(message, name))


def write_mcap(path, list_of, **options):
    """Writes with the package mcap: other chunks and compressions than rosbags has."""
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="ros2", library="make_bags")
        channels = {}
        for log_ns, topic, message in list_of:
            name = message.__msgtype__
            if topic not in channels:
                schema = writer.register_schema(name, "ros2msg", STORE.generate_msgdef(name, ros_version=2)[0].encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE.serialize_cdr(message, name))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()


def split(path, list_of):
    """Writes a folder of three files, of which the second is listed third."""
    path.mkdir()
    third = len(list_of) // 3
    names = []
    for k in range(3):
        part = path / f"split_{k}.mcap"
        write_mcap(part, list_of[k * third: (k + 1) * third if k < 2 else None], compression=CompressionType.NONE)
        names.append(part.name)
    lines = "".join(f"    - {name}\n" for name in names)
    (path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{lines}  compression_mode: \"\"\n")


def rgbd_expected(path):
    """The frames as rosbags reads them from the bag, straightened by OpenCV."""
    found = {}
    with Reader(path) as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(STORE.deserialize_cdr(raw, connection.msgtype))
    camera = np.array(found[INFO][0].k).reshape(3, 3)
    maps = cv2.initUndistortRectifyMap(camera, np.array(found[INFO][0].d), None, camera, (WIDTH, HEIGHT), cv2.CV_32FC1)
    inside = (maps[0] >= -0.5) & (maps[0] < WIDTH - 0.5) & (maps[1] >= -0.5) & (maps[1] < HEIGHT - 0.5)
    frames = []
    for k, (color, depth, mask, at) in enumerate(zip(found[COLOR], found[DEPTH], found[MASKS], found["/object/pose"])):
        rgb = color.data.reshape(HEIGHT, WIDTH, 3)
        levels = depth.data.view("<u2").reshape(HEIGHT, WIDTH)
        straight = cv2.remap(rgb, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) * inside[..., None]
        metres = cv2.remap(levels, *maps, cv2.INTER_NEAREST) * 0.001 * inside
        labels = cv2.remap(mask.data.reshape(HEIGHT, WIDTH), *maps, cv2.INTER_NEAREST) * inside
        seconds = k * PERIOD_NS * 1e-9
        frames.append({
            "stamp_ns": depth.header.stamp.sec * 10**9 + depth.header.stamp.nanosec,
            "color": straight.ravel().tolist(),
            "depth_m": np.round(metres, 6).ravel().tolist(),
            "mask": (labels > 0).astype(int).ravel().tolist(),
            "map_from_optical": (matrix(*camera_at(seconds)) @ matrix(*OPTICAL)).tolist(),
            "joints": {"finger": 0.5 + seconds, "thumb": -0.1 * seconds},
            "object_z": at.pose.position.z,
        })
    return {"k": list(K), "frames": frames}


def encodings(folder):
    """One message for each encoding, and the values of its pixels."""
    rng = np.random.default_rng(7)
    rgb = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), (3, 3), 1)
    rgba = np.dstack([rgb, np.full((HEIGHT, WIDTH), 9, np.uint8)])
    grey = rgb[..., 1].copy()
    labels = rng.integers(0, 4, (HEIGHT, WIDTH)).astype(np.uint16) * 300
    levels = rng.integers(0, 3000, (HEIGHT, WIDTH)).astype(np.uint16)
    metres = (levels * 0.001).astype(np.float32)
    holes = metres.copy()
    holes[0, :3] = [np.nan, np.inf, -1]
    clean = np.where(np.isfinite(holes) & (holes > 0), holes, 0)
    bgra = rgba[..., [2, 1, 0, 3]]
    stamp = START_NS
    out, expected = [], {}

    def add(topic, message, kind, values):
        out.append((START_NS + len(out), topic, message))
        expected[topic] = {"kind": kind, "values": np.asarray(values).ravel().tolist()}

    for name, pixels in [("rgb8", rgb), ("bgr8", rgb[..., ::-1]), ("rgba8", rgba), ("bgra8", bgra)]:
        add(f"/color/{name}", image(stamp, name, pixels), "colours", rgb)
    add("/color/rgb8_padded", image(stamp, "rgb8", rgb, padding=5), "colours", rgb)
    add("/color/mono8", image(stamp, "mono8", grey), "colours", np.dstack([grey] * 3))
    # The codes of OpenCV name the second row, from its second pixel.
    for name, code in [("rggb", cv2.COLOR_BayerBG2RGB), ("grbg", cv2.COLOR_BayerGB2RGB), ("gbrg", cv2.COLOR_BayerGR2RGB), ("bggr", cv2.COLOR_BayerRG2RGB)]:
        add(f"/bayer/{name}", image(stamp, f"bayer_{name}8", grey), "bayer", cv2.cvtColor(grey, code))
    for big in [False, True]:
        end = "big" if big else "little"
        for padding in [0, 6]:
            add(f"/depth/16_{end}_{padding}", image(stamp, "16UC1", levels, big=big, padding=padding), "depth", metres)
            add(f"/depth/32_{end}_{padding}", image(stamp, "32FC1", holes, big=big, padding=padding), "depth", clean)
        add(f"/labels/16_{end}", image(stamp, "16UC1", labels, big=big), "labels", labels)
        add(f"/labels/mono16_{end}", image(stamp, "mono16", labels, big=big), "labels", labels)
    add("/labels/8", image(stamp, "8UC1", grey, padding=3), "labels", grey)

    def file(ending, pixels, *options):
        return cv2.imencode(ending, pixels, *options)[1].tobytes()

    jpeg = file(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    decoded = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    add("/color/jpeg", compressed(stamp, "rgb8; jpeg compressed bgr8", jpeg), "jpeg", decoded)
    add("/color/jpeg_short", compressed(stamp, "jpeg", jpeg), "jpeg", decoded)
    add("/color/png", compressed(stamp, "bgr8; png compressed bgr8", file(".png", rgb[..., ::-1])), "colours", rgb)
    add("/labels/png", compressed(stamp, "mono8; png compressed ", file(".png", grey)), "labels", grey)
    add("/labels/png16", compressed(stamp, "mono16; png compressed ", file(".png", labels)), "labels", labels)
    add("/depth/png16", compressed(stamp, "16UC1; png compressed ", file(".png", levels)), "depth", metres)
    head = np.array([0], "<i4").tobytes() + np.array([0, 0], "<f4").tobytes()
    add("/depth/compressed_16", compressed(stamp, "16UC1; compressedDepth", head + file(".png", levels)), "depth", metres)
    # image_transport_plugins: a = quantization * (quantization + 1), b = 1 - a / max; level = a / depth + b.
    quantization, most = 100.0, 10.0
    a = quantization * (quantization + 1.0)
    b = 1.0 - a / most
    level = np.where(metres > 0, a / np.maximum(metres, 1e-3) + b, 0)
    level = np.where(level < 65535, level, 0).astype(np.uint16)
    inverse = np.where(level > 0, a / (level.astype(np.float32) - np.float32(b)), 0)
    head = np.array([0], "<i4").tobytes() + np.array([a, b], "<f4").tobytes()
    add("/depth/compressed_32", compressed(stamp, "32FC1; compressedDepth png", head + file(".png", level)), "depth", inverse)

    eight = [0.2, -0.1, 0.001, 0.002, 0.05, 0.15, -0.02, 0.01]
    grid = [[u, v] for u in range(0, WIDTH, 5) for v in range(0, HEIGHT, 4)]
    rays = np.array([[(u - K[2]) / K[0], (v - K[5]) / K[4], 1.0] for u, v in grid])
    camera = np.array(K).reshape(3, 3)
    for topic, model, d in [("/info/plumb_bob", "plumb_bob", D), ("/info/rational_polynomial", "rational_polynomial", eight)]:
        places, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera, np.array(d))
        add(topic, info(stamp, model, d), "lens", np.hstack([np.array(grid, float), places.reshape(-1, 2)]))
    write(folder, out, StoragePlugin.SQLITE3)
    return expected


def large(folder):
    """Bags of 1,000 frames of 640 x 480 pixels."""
    width, height = 640, 480
    v, u = np.mgrid[:height, :width]
    noise = np.random.default_rng(1).integers(0, 12, (height, width, 3))
    k = [600.0, 0, 319.5, 0, 600.0, 239.5, 0, 0, 1.0]
    for name, options in [("plain", {"compression": CompressionType.NONE}), ("lz4", {"compression": CompressionType.LZ4}), ("zstd", {"compression": CompressionType.ZSTD}), ("db3", None)]:
        def frames():
            for n in range(1000):
                stamp = START_NS + n * PERIOD_NS
                color = ((np.dstack([u // 3, v // 2, (u + v) // 5]) + noise + n) % 256).astype(np.uint8)
                depth = (800 + u // 2 + v // 3 + (n * 7 + u * v) % 4).astype(np.uint16)
                yield stamp, COLOR, image(stamp, "rgb8", color)
                yield stamp + 1, DEPTH, image(stamp, "16UC1", depth)
                yield stamp + 2, INFO, info(stamp, d=[], width=width, height=height, k=k)
        path = folder / name
        shutil.rmtree(path, ignore_errors=True)
        if options is None:
            write(path, frames(), StoragePlugin.SQLITE3)
        else:
            path.mkdir(parents=True)
            write_mcap(path / "bag.mcap", frames(), **options)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--large", type=Path)
    arguments = parser.parse_args()
    if arguments.large:
        large(arguments.large)
        return
    for old in ["db3", "db3_message", "db3_file", "mcap", "mcap_storage", "mcap_message", "mcap_file", "split", "encodings", "db3_unsorted"]:
        shutil.rmtree(DATA / old, ignore_errors=True)
    list_of = messages()
    for name, storage, mode in [
        ("db3", StoragePlugin.SQLITE3, CompressionMode.NONE),
        ("db3_message", StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        ("db3_file", StoragePlugin.SQLITE3, CompressionMode.FILE),
        ("mcap", StoragePlugin.MCAP, CompressionMode.NONE),
        ("mcap_storage", StoragePlugin.MCAP, CompressionMode.STORAGE),
        ("mcap_message", StoragePlugin.MCAP, CompressionMode.MESSAGE),
        ("mcap_file", StoragePlugin.MCAP, CompressionMode.FILE),
    ]:
        write(DATA / name, list_of, storage, mode)
    expected = {"rgbd": rgbd_expected(DATA / "db3")}
    for name in ["db3_message", "db3_file", "mcap", "mcap_storage", "mcap_message", "mcap_file"]:
        assert rgbd_expected(DATA / name) == expected["rgbd"], name
    write_mcap(DATA / "lz4.mcap", list_of, compression=CompressionType.LZ4, chunk_size=2000)
    write_mcap(DATA / "unchunked.mcap", list_of, use_chunking=False)
    # Two topics that are recorded out of order: the first half of the messages comes last.
    write_mcap(DATA / "unsorted.mcap", list_of[14:] + list_of[:14], compression=CompressionType.ZSTD, chunk_size=1500, enable_crcs=False)
    write(DATA / "db3_unsorted", list_of[14:] + list_of[:14], StoragePlugin.SQLITE3)
    split(DATA / "split", list_of)
    expected["order"] = [[log_ns, topic] for log_ns, topic, _ in list_of]
    expected["encodings"] = encodings(DATA / "encodings")
    (DATA / "expected.json").write_text(json.dumps(expected, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
