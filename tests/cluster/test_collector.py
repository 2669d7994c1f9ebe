"""TorchRL's collector with Ray, as the guide shows it."""

import pytest

from tests.test_docs import FILES


@pytest.mark.long
def test_the_documented_loop_sees_the_policy_and_the_memory_that_acted(
    cluster, tmp_path, monkeypatch
):
    """Before it learns from a batch, the policy gives the log-probabilities that were stored."""
    (tmp_path / "cluster_loop.py").write_text(FILES["cluster_loop.py"])
    names = {"__name__": "cluster_loop_shown"}
    exec(FILES["cluster_loop.py"], names)
    away = names["main"](address=cluster, log_to_driver=False)
    assert len(away) == 3
    assert away == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)
