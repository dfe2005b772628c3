"""Simulator-in-the-loop visuotactile SLAM from Python.

A robot hand with four DIGIT touch sensors turns an object. This package simulates and renders it, reads touch images
with a network, estimates shape and pose of the object, and scores the estimate. The page docs/python.md is a tutorial.

Lengths are metres unless a name ends in `_mm`; angles are radians. A pose is a 4 x 4 matrix that takes coordinates of
the named thing to the world, the frame of the hand: x points from the palm to the fingers, z out of the palm. Cameras
have OpenGL axes: they look along -z, and y points up. The 16 joints stand in the order index, middle, ring, thumb, four
each, from the base. Images have the shape (height, width, 3) and dtype uint8.
"""

from . import _library

_library.load()

from ._native import (  # noqa: E402
    Camera,
    Episode,
    EpisodeState,
    Estimate,
    Frame,
    Log,
    LogFrames,
    Recording,
    RecordingFrame,
    Slam,
    TouchNetwork,
    TouchPrediction,
    TouchRendering,
    record_log,
    render_touch,
    score,
    score_poses,
    segment,
    version,
)
from .errors import ArgumentError, Error, FileError, InternalError  # noqa: E402

__version__ = version()

__all__ = [
    "ArgumentError",
    "Camera",
    "Episode",
    "EpisodeState",
    "Error",
    "Estimate",
    "FileError",
    "Frame",
    "InternalError",
    "Log",
    "LogFrames",
    "Recording",
    "RecordingFrame",
    "Slam",
    "TouchNetwork",
    "TouchPrediction",
    "TouchRendering",
    "record_log",
    "render_touch",
    "score",
    "score_poses",
    "segment",
]
