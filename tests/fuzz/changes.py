"""Random changes of the composed configs of all recipes, from a seed."""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

import zfall
from zfall.configs import compose_config, config_folder, options_of

WEIRD = [
    *("true", "false", "null", "nan", "inf", "-inf", "-1", "0", "-0.5", "3.7", "1e12", "abc", "''"),
    *("[]", "{}", "[0,0]", "[1]", "[nan,1]", "[2,1]", "{a: 1}", "'Grüße 🤖'", "???", "'${nosuch}'"),
    *("a.b.c", "[[1,2],[3]]", "[abc]", "'1'", "'  '", "[null]", "{_target_: os.getcwd}", "[-1,-1]"),
]
FALLS = Path(zfall.__file__).parent / "falling/assets/zeroth01_falls.npz"
TARGETS = ["nowhere.Nothing", "zfall", "math.pi", "builtins.dict", "torch.nn.Linear", "3", "''"]
# So many of them would take all memory or all day before anything can be refused.
SIZES = ("num_envs", "rollout_steps", "hidden_size", "num_layers", "num_cells", "components")
SIZES += ("directions", "starts", "candidates", "trials", "seconds", "impulses", "minibatches")
HUGE = ("1e12", "inf")
# What each recipe may be given besides; the first words are for all of its changes.
RECIPES: dict[str, tuple[list[str], list[tuple[str, ...]]]] = {
    "train": (
        ["num_envs=4", "rollout_steps=4", "minibatches=1", "showcase=null", "logger=[]"],
        [
            *((f"env={name}",) for name in options_of("env")),
            *((f"actor={name}",) for name in ("mlp_gaussian", "gru_mog", "mlp_shared_mog")),
            *((f"critic={name}",) for name in ("mlp", "gru")),
            *((f"loss={name}",) for name in options_of("loss")),
            *(("caps=atalante",), ("symmetry=loss",), ("symmetry=augmentation",)),
            *(("experiment=best", "imitation=teacher"), ("experiment=push_to_kneel_kneel",)),
            *(("+push=zf_easy", "+curriculum=zf"), ("+randomization=icub",), ("servo=datasheet",)),
            ("env=zeroth_fall", "+reward=zf_recover"),
            ("env=atalante_standing", "+ablation=[plain_reward,no_limits]"),
        ],
    ),
    "evaluate": (
        [],
        [
            *(("run=pose_hold", f"battery={name}") for name in options_of("battery")),
            *(("run=best",), ("runs=[limp,pose_hold]",), ("run=best", "trial=3")),
            ("run=scripted_kneel", "battery=kneel", "env=push_to_kneel"),
        ],
    ),
    "play": ([], [("run=best",), ("run=limp", "env=push_recovery")]),
    "export": ([], [("run=best",)]),
    "bench": (["num_envs=4", "peers=false"], [(), ("only=quickstart",)]),
    "ablate": ([], [(f"study={name}",) for name in options_of("study")]),
    "falling.falls": ([], [("run=best",)]),
    "falling.trigger": ([], [("run=best",)]),
    "falling.switch": ([], [("recover=best", "kneel=script")]),
    "falling.catches": (
        [f"falls={FALLS}", "candidates=4", "trials=1", "elite=2"],
        [()],
    ),
}
WEIGHTS = {"train": 10, "evaluate": 4, "ablate": 2}


class Change(NamedTuple):
    """One change: the recipe, its words, the key that it is about, and whether it is nonsense.

    Attributes:
        nonsense: whether nothing but a refusal will do: NaN, ``true`` for a number, text for a
            flag, a key that no class takes.
    """

    recipe: str
    words: list[str]
    key: str
    nonsense: bool


def changes(seed: int, count: int) -> Iterator[Change]:
    """So many of them; those of a seed begin alike, however many there are."""
    rng = random.Random(seed)
    composed: dict[tuple[str, ...], DictConfig] = {}
    names = list(RECIPES)
    weights = [WEIGHTS.get(name, 1) for name in names]
    for _ in range(count):
        (recipe,) = rng.choices(names, weights)
        always, given = RECIPES[recipe]
        base = [*always, *rng.choice(given)]
        place = (recipe, *base)
        if place not in composed:
            composed[place] = _composed(recipe, base)
        yield _change(rng, recipe, base, composed[place])


def _composed(recipe: str, words: list[str]) -> DictConfig:
    if "." not in recipe:
        return compose_config(words, recipe)
    path = config_folder() / f"{recipe.replace('.', '/')}.yaml"  # without groups
    cfg = OmegaConf.merge(OmegaConf.load(path), OmegaConf.from_dotlist(words))
    assert isinstance(cfg, DictConfig)
    return OmegaConf.masked_copy(cfg, [key for key in cfg if key not in ("defaults", "hydra")])


def _change(rng: random.Random, recipe: str, base: list[str], cfg: DictConfig) -> Change:
    config = OmegaConf.to_container(cfg)
    assert isinstance(config, dict)
    leaves, tables = list(_leaves(config)), list(_tables(config))
    kind = rng.choice(
        ["value"] * 8 + ["misspelt", "missing", "added", "shorter", "target", "other"]
    )
    key, value = rng.choice(leaves)
    if kind == "target":
        targets = [each for each, _ in leaves if each.endswith("_target_")]
        if targets:
            key = rng.choice(targets)
            return Change(recipe, [*base, f"{key}={rng.choice(TARGETS)}"], key, False)
        kind = "value"
    if kind == "misspelt":
        wrong = _misspelt(rng, key)
        return Change(recipe, [*base, f"{wrong}=1"], wrong, wrong != key)
    if kind == "added":
        key, table = rng.choice(tables)
        wrong = f"{key}.{rng.choice(['sixe', 'x', 'größe', '_partal_', 'std_'])}".lstrip(".")
        return Change(recipe, [*base, f"+{wrong}=1"], wrong, "_target_" in table)
    if kind == "missing":
        key = rng.choice([key, rng.choice(tables)[0]]) or key
        return Change(recipe, [*base, f"~{key}"], key, False)
    if kind == "shorter":
        lists = [(k, v) for k, v in _lists(config)]
        if lists:
            key, value = rng.choice(lists)
            return Change(recipe, [*base, f"{key}={_word(value[:-1])}"], key, False)
    if kind == "other":
        other, _ = rng.choice(leaves)
        return Change(recipe, [*base, f"{key}='${{{other}}}'"], key, False)
    words = [w for w in WEIRD if not (w in HUGE and any(size in key for size in SIZES))]
    word = rng.choice(words)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    flag = isinstance(value, bool)
    nonsense = "nan" in word or (number and word in ("true", "false", "abc"))
    nonsense = nonsense or (flag and word in ("abc", "3.7", "[]"))
    return Change(recipe, [*base, f"{key}={word}"], key, nonsense)


def _leaves(config: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Full key and value of what stands in tables; a list is one value."""
    for name, value in config.items():
        place = f"{key}.{name}" if key else str(name)
        if isinstance(value, dict) and value:
            yield from _leaves(value, place)
        elif _can_be_named(place):
            yield place, value


def _tables(config: Any, key: str = "") -> Iterator[tuple[str, dict[Any, Any]]]:
    if _can_be_named(key):
        yield key, config
    for name, value in config.items():
        if isinstance(value, dict):
            yield from _tables(value, f"{key}.{name}" if key else str(name))


def _lists(config: Any) -> Iterator[tuple[str, list[Any]]]:
    for key, value in _leaves(config):
        if isinstance(value, list) and value and "'" not in str(value).replace("', '", ""):
            yield key, value


def _can_be_named(key: str) -> bool:
    """Whether the shell's grammar takes it: names of a study's rows are sentences."""
    return all(part.replace("_", "").isalnum() for part in key.split(".") if part)


def _misspelt(rng: random.Random, key: str) -> str:
    head, _, last = key.rpartition(".")
    at = rng.randrange(len(last))
    last = rng.choice([last[:at] + last[at + 1 :], last[:at] + last[at] + last[at:], last + "s"])
    return f"{head}.{last}".lstrip(".")


def _word(value: Any) -> str:
    if isinstance(value, list):
        return f"[{','.join(map(_word, value))}]"
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}: {_word(each)}" for key, each in value.items()) + "}"
    return "null" if value is None else str(value)
