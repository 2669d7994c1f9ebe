"""Arrays of npz files."""

import pickle
import random
from pathlib import Path

import numpy as np
import pytest

from zfall.arrays import arrays_of
from zfall.falling.banks import load_bank
from zfall.falling.files import ASSETS, MOVEMENTS
from zfall.falling.movements import load_catches
from zfall.robots import ZEROTH01


def refusal(path: Path, key: str = "a") -> str:
    with pytest.raises(ValueError, match="bank must") as caught, arrays_of(path, "bank must") as f:
        f[key]
    assert "\n" not in str(caught.value)
    assert "allow_pickle" not in str(caught.value)
    return str(caught.value)


def test_arrays_are_read_and_what_is_no_such_file_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.arange(3.0))
    with arrays_of(path, "bank must") as file:
        assert file["a"].tolist() == [0.0, 1.0, 2.0]
    assert "it lacks b" in refusal(path, "b")
    assert "there is no" in refusal(tmp_path / "no.npz")
    np.save(tmp_path / "a.npy", np.arange(3.0))
    refusal(tmp_path / "a.npy")
    path.write_bytes(path.read_bytes()[:-30])
    refusal(path)
    path.write_bytes(b"")
    refusal(path)


class Evil:
    def __init__(self, path: str):
        self.path = path

    def __reduce__(self) -> tuple:
        return (open, (self.path, "w"))


def test_pickles_are_not_read(tmp_path):
    evil = np.array([Evil(str(tmp_path / "executed"))], dtype=object)
    np.savez(tmp_path / "a.npz", a=evil)
    refusal(tmp_path / "a.npz")
    (tmp_path / "b.npz").write_bytes(pickle.dumps(Evil(str(tmp_path / "executed"))))
    refusal(tmp_path / "b.npz")
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    ("path", "read"),
    [
        (MOVEMENTS, lambda path: load_catches(ZEROTH01, path)),
        (ASSETS / "zeroth01_falls.npz", lambda path: load_bank(path, ZEROTH01)),
    ],
)
def test_a_flipped_bit_is_refused_or_changes_nothing_that_is_read(tmp_path, path, read):
    whole, sound = path.read_bytes(), read(path)
    copy, rng = tmp_path / path.name, random.Random(0)
    for position in rng.sample(range(len(whole)), 25):
        flipped = bytearray(whole)
        flipped[position] ^= 1 << position % 8
        copy.write_bytes(flipped)
        try:
            found = read(copy)
        except ValueError as error:
            assert "\n" not in str(error)
            continue
        values = found.values() if isinstance(found, dict) else found
        expected = sound.values() if isinstance(sound, dict) else sound
        assert all(map(np.array_equal, values, expected, strict=True))
