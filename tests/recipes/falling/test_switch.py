"""Two policies that are switched by the mode."""

import pytest
import torch
from omegaconf import OmegaConf

from tests.shell import run
from zfall import checkpoint

MIRRORED = "{_target_: zfall.falling.mirrored_falls.MirroredFalls}"


@pytest.mark.long
def test_two_policies_are_switched_by_the_mode(tmp_path):
    common = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    for seed, name in enumerate(("recover", "kneel")):
        own = [f"experiment=push_to_kneel_{name}", f"seed={seed}"]
        own += [f"env.transforms.mirrored_falls={MIRRORED}"] if name == "kneel" else []
        done = run("train", *own, *common, f"hydra.run.dir={tmp_path}/{name}")
        assert done.returncode == 0, done.stderr
    both = [f"recover={tmp_path}/recover", f"kneel={tmp_path}/kneel"]
    change = 'change=["transforms.mode.probability=0.9"]'
    done = run("falling.switch", *both, change, f"hydra.run.dir={tmp_path}/both")
    assert done.returncode == 0, done.stderr
    parts = {
        name: checkpoint.load(tmp_path / name / "checkpoints" / "last.pt")
        for name in ("recover", "kneel", "both")
    }
    config = OmegaConf.create(parts["both"]["config"])
    assert config.env.transforms.mode.probability == 0.9
    assert config.actor.begins  # as its episodes do
    assert config.env.transforms.mirrored_falls == {"_target_": MIRRORED[11:-1]}
    mode = config.env.transforms.mode  # in training rest may be 2 m/s
    assert mode.rest_speed == mode.rest_joint_speed == 0.1
    for name in ("recover", "kneel"):
        for key, value in parts[name]["policy"].items():
            assert torch.equal(parts["both"]["policy"][f"{name}.{key}"], value)
    key = next(key for key in parts["kneel"]["policy"] if key.endswith("mean.weight"))
    assert not torch.equal(parts["recover"]["policy"][key], parts["kneel"]["policy"][key])
    kneel = ["battery=kneel", "impulses=[1.0]", "directions=2", "starts=1", "force_starts=1"]
    done = run(
        "evaluate",
        f"run={tmp_path}/both",
        *kneel,
        "end_time=1.5",
        'change=["transforms.mode.angle=0.3"]',
    )
    assert done.returncode == 0, done.stderr
    done = run("falling.switch", both[0], "kneel=script", f"hydra.run.dir={tmp_path}/script")
    assert done.returncode == 0, done.stderr
    config = checkpoint.load(tmp_path / "script" / "checkpoints" / "last.pt")["config"]
    assert OmegaConf.create(config).env.transforms.mode.hold == 0.2  # not the 100 s of its phase A
    done = run("evaluate", f"run={tmp_path}/script", *kneel, "end_time=1.5")
    assert done.returncode == 0, done.stderr
    keys = "env.transforms.observation.keys=[projected_gravity,joint_position,joint_velocity]"
    own = [keys, *common, f"hydra.run.dir={tmp_path}/other"]
    other = run("train", "experiment=push_to_kneel_kneel", *own)
    assert other.returncode == 0, other.stderr
    bad = run("falling.switch", both[0], f"kneel={tmp_path}/other", f"hydra.run.dir={tmp_path}/bad")
    assert "must have the same env.transforms.observation" in bad.stderr
    speed = "{_target_: zfall.envs.transforms.estimation.NumericalVelocity, before: observation}"
    added = [
        f"+env.transforms.speed={speed}",
        "env.transforms.noise=null",
        "~env.training_only.noise",
    ]
    own = [*added, *common, f"hydra.run.dir={tmp_path}/speed"]
    estimated = run("train", "experiment=push_to_kneel_kneel", *own)
    assert estimated.returncode == 0, estimated.stderr
    bad = run("falling.switch", both[0], f"kneel={tmp_path}/speed", f"hydra.run.dir={tmp_path}/bad")
    assert "kneel must need no speed besides action and observation to be switched" in bad.stderr
    bad = run("falling.switch", "recover=best", "kneel=best", f"hydra.run.dir={tmp_path}/bad")
    assert "kneel must be a policy that kneels, trained with modes; best is not" in bad.stderr
