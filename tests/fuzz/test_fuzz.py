"""Whatever the shell gives: it works, or one line says which key, which rule and which value."""

from collections import Counter

import pytest

from tests.fuzz.changes import changes
from tests.fuzz.outcome import outcome_of


def fuzz(seed: int, count: int, patch: pytest.MonkeyPatch, folder: str) -> Counter[str]:
    found: Counter[str] = Counter()
    faults: list[str] = []
    for change in changes(seed, count):
        outcome = outcome_of(change, patch.setattr, folder)
        given = f"{change.recipe} {' '.join(change.words)}"
        if outcome.broken:
            found["broken"] += 1
            faults.append(f"{given}\n    {outcome.broken}")
        elif outcome.accepted:
            found["accepted"] += 1
            if change.nonsense:
                found["nonsense"] += 1
                faults.append(f"{given}\n    accepted")
        else:
            found["refused"] += 1
            if outcome.names_key and outcome.names_rule and outcome.names_value:
                found["clear"] += 1
            else:
                print(f"unclear: {given}\n    {outcome.line}")
    print(dict(found))
    assert not faults, "\n".join(faults)
    return found


@pytest.mark.long
def test_forty_changes_are_taken_or_refused_in_one_clear_line(monkeypatch, tmp_path):
    found = fuzz(0, 40, monkeypatch, f"{tmp_path}/out")
    assert found["clear"] >= 0.97 * found["refused"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 5))
def test_two_thousand_changes(seed, monkeypatch, tmp_path):
    found = fuzz(seed, 500, monkeypatch, f"{tmp_path}/out")
    assert found["clear"] >= 0.97 * found["refused"]
