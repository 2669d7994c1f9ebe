"""The files of the playground's page: its own, and the libraries that npm fetches."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

PAGE = ("index.html", "style.css", "js")
VENDOR = {  # from node_modules, to vendor/
    "@mujoco/mujoco/mujoco.js": "mujoco/mujoco.js",
    "@mujoco/mujoco/mujoco.wasm": "mujoco/mujoco.wasm",
    "onnxruntime-web/dist/ort.wasm.min.mjs": "onnxruntime/ort.wasm.min.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.mjs": "onnxruntime/ort-wasm-simd-threaded.mjs",
    "onnxruntime-web/dist/ort-wasm-simd-threaded.wasm": "onnxruntime/ort-wasm-simd-threaded.wasm",
    "three/build/three.module.js": "three/three.module.js",
    "three/build/three.core.js": "three/three.core.js",
    "three/examples/jsm/controls/OrbitControls.js": "three/addons/controls/OrbitControls.js",
    "three/examples/jsm/geometries/RoundedBoxGeometry.js": (
        "three/addons/geometries/RoundedBoxGeometry.js"
    ),
    "three/LICENSE": "three/LICENSE",
}


def check_folder(out: Path, sources: Path) -> None:
    """Refuses to mix the page with what it does not know, and a place without the sources.

    Args:
        out: of the page.
        sources: of its own files and the lock of its libraries.

    Raises:
        ValueError: naming what is wrong.
    """
    if not sources.is_dir():
        raise ValueError("playground must be built in a clone of the project: its pages are there.")
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not (out / "robot.json").exists()):
        raise ValueError(f"out must be a new or empty folder, or one built before, got {out}.")


def fetch_libraries(sources: Path) -> Path:
    """``node_modules`` with the pinned libraries, by ``npm ci`` if they are not there.

    Raises:
        ValueError: without npm, or if it fails.
    """
    folder = sources / "node_modules"
    lock, done = sources / "package-lock.json", folder / ".of-lock"
    if done.exists() and done.read_text() == lock.read_text():
        return folder
    if shutil.which("npm") is None:
        raise ValueError("npm must be on the PATH, for the page's libraries: install Node.js 20.")
    command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
    ran = subprocess.run(command, cwd=sources, capture_output=True, text=True, check=False)
    if ran.returncode:
        last = (ran.stderr.strip().splitlines() or ["nothing"])[-1]
        raise ValueError(f"npm ci must fetch the page's libraries, it says: {last}")
    done.write_text(lock.read_text())
    return folder


def copy_page(out: Path, sources: Path) -> None:
    """Puts the page and its libraries into a folder.

    Raises:
        ValueError: as ``fetch_libraries``.
    """
    libraries = fetch_libraries(sources)
    out.mkdir(parents=True, exist_ok=True)
    for name in PAGE:
        source = sources / name
        copy: Any = shutil.copytree if source.is_dir() else shutil.copy
        copy(source, out / name, **({"dirs_exist_ok": True} if source.is_dir() else {}))
    for name, place in VENDOR.items():
        (out / "vendor" / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(libraries / name, out / "vendor" / place)
