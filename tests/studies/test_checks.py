"""Values of a study of another kind than it takes are refused as it is made."""

import re

import pytest


@pytest.mark.parametrize(
    ("change", "key", "value"),
    [
        ({"name": 3}, "study.name", "3"),
        ({"rows": {}}, "study.rows", "{}"),
        ({"rows": {"a": "symmetry=loss"}}, "study.rows.a", "symmetry=loss"),
        ({"rows": {"a": [3]}}, "study.rows.a", "[3]"),
        ({"rows": {"a": None}}, "study.rows.a", "None"),
        ({"base": "experiment=best"}, "study.base", "experiment=best"),
        ({"tests": {"n": "env=icub_balance"}}, "study.tests.n", "env=icub_balance"),
        ({"tests": [1]}, "study.tests", "[1]"),
        ({"battery": "planar"}, "study.battery", "planar"),
        ({"battery": {"starts": 1}}, "study.battery", "{'starts': 1}"),
        ({"seeds": []}, "study.seeds", "[]"),
        ({"seeds": 3}, "study.seeds", "3"),
        ({"seeds": [True]}, "study.seeds", "[True]"),
        ({"seeds": [0, 0]}, "study.seeds", "[0, 0]"),
        ({"row_seeds": {"none": ["x"]}}, "study.row_seeds.none", "['x']"),
        ({"row_seeds": {"nobody": [0]}}, "study.row_seeds", "nobody"),
        ({"tested_with": {"nobody": {"_target_": "a.B"}}}, "study.tested_with", "nobody"),
        ({"tested_with": {"none": "best"}}, "study.tested_with.none", "best"),
        ({"tested_with": {"none": {"recover": "best"}}}, "study.tested_with.none", "best"),
        ({"total_frames": 0}, "study.total_frames", "0"),
    ],
)
def test_a_value_of_another_kind_is_named(tiny, change, key, value):
    with pytest.raises(ValueError, match=re.escape(key) + " .*" + re.escape(value)):
        tiny(**change)


@pytest.mark.parametrize(
    "name",
    [
        "../../evil",
        "/tmp/evil",
        "",
        ".",
        "..",
        "a/b",
        "a\\b",
        "-rf",
        ".hidden",
        "a\n",
        "a" * 101,
        None,
        True,
    ],
)
def test_a_name_is_that_of_one_plain_file(tiny, name):
    with pytest.raises(ValueError, match="study.name must .*" + re.escape(repr(name))):
        tiny(name=name)


def test_lists_may_be_tuples(tiny):
    assert tiny(seeds=(0,), base=("num_envs=8",)).seeds == (0,)
