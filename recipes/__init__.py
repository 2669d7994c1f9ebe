"""Programs started from the shell.

zfall comes first: it picks an OpenGL before TorchRL imports MuJoCo.
"""

import zfall  # noqa: F401
