"""What may be changed in the table of a task, what two of them must share, what classes declare."""

import pytest
from omegaconf import OmegaConf

from zfall.envs.make import left_out
from zfall.envs.tables import check_same_interface, declaring, keep


def test_what_evaluation_leaves_out_can_be_kept_by_its_name(compose_config):
    cfg = compose_config("num_envs=2").env
    assert {"noise", "delay"} <= set(left_out(cfg.training_only))
    assert {"noise", "delay"}.isdisjoint(left_out(keep(cfg, ["noise", "delay"]).training_only))
    with pytest.raises(ValueError, match=r"keep must name what evaluation leaves out .*got action"):
        keep(cfg, ["action"])


@pytest.mark.parametrize(
    ("one", "other", "message"),
    [
        ({"scale": 0.6, "keys": ["a"]}, {"scale": 0.6, "keys": ["b"]}, r"action.keys, got \['a'\] and \['b'\]"),
        ({"scale": 0.6}, {"scale": 0.6, "limit": None}, "action.limit, got nothing and None"),
        ({"in": {"low": 1, "high": 2}}, {"in": {"low": 1, "high": 3}}, "action.in.high, got 2 and 3"),
    ],
)  # fmt: skip
def test_what_differs_between_two_policies_is_named(one, other, message):
    base = {"base_env": {"control_dt": 0.04}}
    configs = {
        name: OmegaConf.create({"env": base | {"transforms": {"action": value, "observation": {}}}})
        for name, value in (("A", one), ("B", other))
    }
    with pytest.raises(ValueError, match=f"A and B must have the same env.transforms.{message}"):
        check_same_interface(configs)


def test_transforms_are_known_by_what_their_class_declares(compose_config):
    quickstart = compose_config().env
    assert set(declaring(quickstart, "replaced_in_batteries")) == {"start", "push"}
    assert declaring(quickstart, "acts_by_itself") == []
    kneel = compose_config("env=push_to_kneel").env
    assert "kneel_reference" in declaring(kneel, "acts_by_itself")
    kneel.transforms.kneel_reference = None  # what is taken out declares nothing
    assert "kneel_reference" not in declaring(kneel, "acts_by_itself")
