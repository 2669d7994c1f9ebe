"""How much memory worlds take, said before it is taken."""

import os

import mujoco

DOUBLE = 8  # [bytes]
# States, sensors and quantities are copied on their way through a step, specs have bounds.
COPIES = 3


def check_memory(model: mujoco.MjModel, num_envs: int, substeps: int) -> None:
    """Refuses more worlds than this machine has memory for.

    Args:
        model: of all worlds.
        num_envs: number of worlds.
        substeps: physics steps of a control step, each of which is kept.

    Raises:
        ValueError: with the memory that they would take.
    """
    state = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    each = state + model.nu + 6 * model.nbody + model.nsensordata
    needed = COPIES * DOUBLE * num_envs * substeps * each
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > there:
        raise ValueError(
            f"num_envs must fit into the memory of this machine, {there / 2**30:.3g} GiB, got "
            f"{num_envs}, which would take {needed / 2**30:.3g} GiB; at most "
            f"{there * num_envs // needed} do."
        )
