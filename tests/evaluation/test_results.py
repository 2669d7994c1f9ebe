"""How results are named in tables and plots."""

from omegaconf import OmegaConf

from zfall.evaluation.results import labels


def test_runs_are_called_by_their_last_folder_unless_two_have_the_same():
    assert labels(["runs/a/first", "runs/b/second", "best"]) == ["first", "second", "best"]
    assert labels(["runs/a/x", "runs/b/x", "best"]) == ["runs/a/x", "runs/b/x", "best"]


def test_jobs_of_a_sweep_are_called_by_what_differs(tmp_path):
    """Two seeds by two learning rates of one number of worlds; a fifth one was given nothing."""
    given = [[f"seed={seed}", "num_envs=8", f"lr={lr}"] for seed in (0, 1) for lr in ("1e-3", 0.1)]
    names = [str(tmp_path / str(number)) for number in range(5)]
    for name, overrides in zip(names, given, strict=False):
        (tmp_path / name / ".hydra").mkdir(parents=True)
        OmegaConf.save(overrides, tmp_path / name / ".hydra" / "overrides.yaml")
    expected = [f"seed={seed}, lr={lr}" for seed in (0, 1) for lr in ("1e-3", 0.1)]
    assert labels(names[:4]) == expected
    assert labels([*names[:2], "best"]) == ["lr=1e-3", "lr=0.1", "best"]
    assert labels(names[:1]) == ["0"]
    assert labels(names)[4] == "4"


def test_a_run_is_called_what_its_name_said(tmp_path):
    for folder, given in (("a", "- name=steady\n"), ("b", "- seed=1\n")):
        (tmp_path / folder / ".hydra").mkdir(parents=True)
        (tmp_path / folder / ".hydra" / "overrides.yaml").write_text(given)
    assert labels([str(tmp_path / "a"), str(tmp_path / "b")]) == ["steady", "b"]
