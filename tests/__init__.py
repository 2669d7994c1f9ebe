"""Tests of zfall, which comes first: it picks an OpenGL before TorchRL imports MuJoCo."""

import zfall  # noqa: F401
