"""What others would use does the same work."""

import mujoco
import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from torchrl.envs.utils import check_env_specs

from benchmarks import peers
from zfall.robots import ZEROTH01


def test_best_number_of_workers_is_what_counts(monkeypatch):
    """Speeds that fall, rise, or do neither with the number of workers."""
    for name, speed in (("parallel_env_dm_control", 5.0), ("torchrl_mujoco_env", -1.0)):
        run_one = lambda actions, seconds, speed=speed: 100.0 + speed * actions.shape[1]  # noqa: E731
        monkeypatch.setattr(peers, f"run_{name}", run_one)
    monkeypatch.setattr(peers, "run_gymnasium_async", lambda actions, seconds: 7.0)
    monkeypatch.setattr(peers, "usable_cores", lambda: 2)
    named = []
    speeds = peers.measure_peers(torch.zeros(4, 16, 20), 0.1, named.append)
    assert speeds == {
        "peer/parallel_env_dm_control": 140.0,
        "peer/torchrl_mujoco_env": 98.0,
        "peer/gymnasium_async": 7.0,
    }
    assert named == list(speeds)


@pytest.mark.parametrize("falls", [False, True])
def test_peer_of_gymnasium_does_the_same_work(compose_config, falls):
    """With nothing random: the observations, rewards and the end of our own env."""
    cfg = compose_config("num_envs=1", "servo=published").env
    cfg.training_only.observation_critic = False
    cfg.transforms.observation_critic["keys"].pop()  # the push, left out too
    ours, peer = instantiate(cfg, training=False), peers.GymnasiumPeer(training=False)
    td, seen = ours.reset(), peer.reset()[0]
    action = torch.zeros(1, 20)
    action[:, 2:4] = 1.0 if falls else 0.05  # hip and knee of one leg
    for step in range(40):
        expected = torch.cat([td["observation"], td["observation_critic"]], -1)[0]
        np.testing.assert_allclose(seen[:-3], expected, atol=5e-3, err_msg=f"step {step}")
        data, td = ours.step_and_maybe_reset(td.set("action", action))
        seen, reward, terminated, truncated, _ = peer.step(action[0].numpy())
        after = data["next"]
        assert reward == pytest.approx(after["reward"].item(), abs=1e-3)
        assert terminated == after["terminated"].item()
        assert not truncated
        if terminated:
            break
    assert terminated == falls


def test_peer_of_gymnasium_pushes_with_the_impulse_given():
    """Sum of force x time over one push; the mean over a step is observed."""
    peer = peers.GymnasiumPeer()
    peer.reset(seed=1)
    peer._force = np.array([0.0, 10.0, 0.0])
    peer._start = 0.0513
    total = sum(0.04 * peer.step(np.zeros(20))[0][-2] for _ in range(4))
    assert total == pytest.approx(1.0, rel=1e-5)  # 10 N for 0.1 s


def test_peer_of_torchrl_does_the_same_work_and_stands():
    env = peers.TorchrlPeer.make(num_workers=1)
    check_env_specs(env)
    td = env.reset()
    for _ in range(25):
        td["action"] = torch.zeros(1, 20)
        data, td = env.step_and_maybe_reset(td)
    assert env.get_state()["time"].item() == pytest.approx(1.0)
    assert not data["next", "terminated"].any()
    assert data["next", "observation"][0, 2].item() == pytest.approx(stand_height(), abs=0.02)


def test_peers_agree_with_each_other():
    """The same physics in two libraries: TorchRL's keeps states in float32."""
    one, other = peers.GymnasiumPeer(training=False), peers.TorchrlPeer.make(num_workers=1)
    one.reset()
    other.reset()
    td = other.reset()
    actions = 0.1 * torch.randn(5, 1, 20)
    actions[..., 12:] = 0.0  # legs alone, far from the stops at which only one of them clamps
    for action in actions:
        one.step(action[0].numpy())
        td["action"] = action[:, one._order]  # that one takes them in the order of the MJCF
        td = other.step_and_maybe_reset(td)[1]
    np.testing.assert_allclose(td["observation"][0].numpy(), one.state_vector(), atol=2e-3)


def stand_height() -> float:
    return float(mujoco.MjModel.from_xml_path(ZEROTH01.mjcf).key("stand").qpos[2])
