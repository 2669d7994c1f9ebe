"""Programs started from the shell.

zfall comes first: it picks an OpenGL before TorchRL imports MuJoCo, and says how torch's threads
wait before torch is loaded.
"""

import zfall  # noqa: F401
