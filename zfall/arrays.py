"""Arrays of npz files: data alone, no pickles, refused in one line if they are damaged."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


@contextmanager
def arrays_of(path: Path, rule: str) -> Iterator[Mapping[str, NDArray[Any]]]:
    """The arrays of a file, to be read and brought into shape within it.

    Args:
        path: of the file.
        rule: what it must be, for messages: ``bank must be a file that ... wrote``.

    Raises:
        ValueError: if there is no such file, it is damaged or of another kind, or what is done
            with its arrays fails.
    """
    if not path.is_file():
        raise ValueError(f"{rule}, there is no {path}.")
    try:
        with np.load(path, allow_pickle=False) as file:
            yield file
    except Exception as error:  # a damaged zip file raises almost anything
        lacks = f"it lacks {error.args[0].split()[0]}" if isinstance(error, KeyError) else ""
        why = lacks or "it is damaged or of another kind"
        raise ValueError(f"{rule}, {path} is none: {why}.") from error
