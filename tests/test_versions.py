"""Which code made a result."""

from importlib.metadata import version

from zfall import versions


def test_packages_are_named_and_a_clone_by_its_commit():
    versions.versions.cache_clear()
    found = versions.versions()
    assert found["torch"] == version("torch")
    assert {"torchrl", "tensordict", "mujoco", "numpy", "zfall"} <= set(found)
    commit = found.get("commit", "0" * 7).removesuffix("-dirty")
    assert len(commit) >= 7
    assert int(commit, 16) >= 0


def test_a_repository_around_an_installed_package_is_not_taken_for_its_own(monkeypatch, tmp_path):
    monkeypatch.setattr(versions, "__file__", str(tmp_path / "versions.py"))
    versions.versions.cache_clear()
    assert "commit" not in versions.versions()
    versions.versions.cache_clear()
