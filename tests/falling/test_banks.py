"""Files with the states of falls."""

import numpy as np
import pytest

from zfall.envs.humanoid import STATE_KEYS
from zfall.falling.banks import PUSH_KEYS, load_bank
from zfall.falling.files import own_file
from zfall.robots import ZEROTH01


@pytest.fixture
def write(tmp_path):
    """Writes two falls of the bank that ships, some of it replaced or left out."""

    def bank(without=(), **values):
        with np.load(own_file(ZEROTH01, "falls.npz")) as file:
            states = {key: file[key][:2] for key in STATE_KEYS if key not in without}
        np.savez(tmp_path / "bank.npz", **{**states, **values})
        return tmp_path / "bank.npz"

    return bank


def test_rows_are_flat_and_only_what_is_there(write):
    bank = load_bank(write(feet_force=np.ones((2, 2, 3), "f8")), ZEROTH01)
    assert list(bank) == [*STATE_KEYS, "feet_force"]
    assert bank["feet_force"].shape == (2, 6)
    assert bank["base_orientation"].shape == (2, 4)


@pytest.mark.parametrize(
    ("without", "values", "message"),
    [
        ((), {}, "lacks push_force"),
        (("joint_velocity",), {}, "lacks joint_velocity"),
        ((), {"joint_position": np.zeros((2, 3))}, "falls must be of zeroth01"),
        ((), {"target": np.zeros((3, 20))}, "2 rows .* target"),
        ((), {"base_position": np.full((2, 3), np.nan)}, "2 rows .* base_position"),
    ],
)
def test_what_is_no_bank_is_refused(write, without, values, message):
    given = {"push_force": np.zeros((2, 3)), "push_left": np.zeros((2, 1))} if values else {}
    with pytest.raises(ValueError, match=message):
        load_bank(write(without, **given, **values), ZEROTH01, needs=PUSH_KEYS, name="falls")


@pytest.mark.parametrize("content", [None, b"no archive", b"PK\x03\x04 cut off"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "bank.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(
        ValueError, match="bank must be a file that recipes.falling.falls .*bank.npz"
    ):
        load_bank(path, ZEROTH01)


def test_an_array_alone_is_refused(tmp_path):
    np.save(tmp_path / "bank.npy", np.zeros(3))
    with pytest.raises(ValueError, match="bank must be a file .*bank.npy"):
        load_bank(tmp_path / "bank.npy", ZEROTH01)
