"""Bad input in one line: what the key is, what the rule, what was given."""

from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches

from hydra.errors import InstantiationException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Ends the program with exit code 1 and one line for errors that the user can repair."""
    try:
        yield
    except InstantiationException as error:
        cause = error.__cause__
        key = str(error).rsplit("full_key:", 1)[-1].strip() if "full_key:" in str(error) else ""
        reason = str(error).splitlines()[0] if cause is None else str(cause)
        raise SystemExit(f"error: {key + ': ' if key else ''}{_flat(reason)}") from None
    except (ValueError, OSError, OmegaConfBaseException) as error:
        raise SystemExit(f"error: {_flat(str(error))}") from None


def check_keys(cfg: DictConfig, known: set[str]) -> None:
    """Refuses top-level keys that nothing reads.

    Raises:
        ValueError: naming the key and the nearest known one.
    """
    for key in cfg:
        if key not in known:
            near = get_close_matches(str(key), known, n=1)
            hint = f"; did you mean {near[0]}?" if near else "."
            raise ValueError(f"{key} is not a key of the config ({', '.join(sorted(known))}){hint}")


def _flat(text: str) -> str:
    return " ".join(text.split())
