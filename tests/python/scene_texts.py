"""Scenes as text for tests."""

import numpy as np
import viscovib as vv


def numbers(values):
    """Numbers of a key; of a matrix row by row."""
    return " ".join(repr(float(value)) for value in np.ravel(values))


def scene_of(tmp_path, text):
    """The scene with this text, read from a file."""
    path = tmp_path / "scene.nml"
    path.write_text(text)
    return vv.Scene.read(path)


def columns_of(result):
    """Columns of the first table that the core makes of a scene, as the driver does."""
    return next(iter(result._tables.values())).columns
