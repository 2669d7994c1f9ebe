"""Recovering, giving up, kneeling, getting up: what a robot does when it can no longer stay up.

A mode machine decides after every step between RECOVER, KNEEL, STABLE and RISE. In KNEEL the
targets follow a movement that catches the fall; a policy may correct it. A small network predicts
falls. In RISE they follow movements that get the robot up from where it lies or kneels.

All of it is written as a user's own extension would be: nothing below this package imports it, and
the general code finds it where yaml names it.

| file | what |
|---|---|
| ``modes/`` | ``ModeMachine``, ``StableHold``, ``FallPredictor``: transforms of the env |
| ``kneel_reference.py``, ``movements.py`` | the way down, and the movements that it goes through |
| ``mirrored_falls.py`` | falls to the left, seen and caught as those to the right |
| ``falling_start.py``, ``banks.py`` | episodes that begin in recorded falls, and their files |
| ``terms.py`` | terms of rewards and ends |
| ``fall_network.py``, ``trigger/`` | the network that predicts falls, and how it is trained |
| ``switched.py``, ``switched_with.py`` | two policies in one, also for studies |
| ``recording.py``, ``pushed.py`` | records banks of falls |
| ``recorded_falls.py``, ``search.py``, ``poses.py`` | searches movements, and poses |
| ``rise_reference.py``, ``rises.py`` | the way up, and the movements that it goes through |
| ``lying.py``, ``standing.py`` | how robots lie before they rise, and when they stand |
| ``rise_search.py`` | searches movements that get up |
| ``kneel_battery.py``, ``kneeling.py``, ``kneel_outcomes.py``, ``baselines.py`` | tests of it |
| ``plots.py`` | figures of a trigger |
| ``making/`` | all of these files, as recipes and as stages of a training make them |
| ``files.py``, ``assets/`` | the files that ship |

The hooks of the general code that it uses:

- a transform is a class in the table of an env, given the base env as ``env``; ``attach`` gets the
  whole table (``zfall.envs.make.make_env``);
- ``measured`` on a transform: what it reads must be sensed earlier (``make_env``);
- ``mirror_signs``, ``mirror_like`` on a transform: how its quantities are mirrored
  (``zfall.envs.mirror.mirrors_of``);
- ``acts_by_itself`` on a transform: it moves the robot without an action, so that a baseline that
  holds still leaves it out; ``replaced_in_batteries``: it starts or pushes, which a battery does
  itself (``zfall.envs.tables.declaring``);
- ``alike`` on a transform: how many worlds in a row begin in the same state
  (``zfall.training.checks.check_task``);
- ``("start", NAME)`` for a state to begin in, ``("push", "wrench")`` for forces
  (``zfall.envs.humanoid.HumanoidEnv``);
- ``reads_files`` on a class: which files decide what it does (``zfall.fingerprints``);
- ``played_with`` on a transform: size and distance in time of the pushes that ``recipes.play`` has
  unless told otherwise (``zfall.evaluation.play``);
- ``mode_names`` on a transform: what the numbers of ``mode`` are called (``zfall.viewer``);
- ``Robot.postures``: named poses of a robot (``zfall.robots``);
- ``kind`` and ``measures`` of a battery's yaml (``zfall.evaluation.kinds``), ``_target_`` of a
  baseline's (``zfall.evaluation.baselines``), ``tested_with`` of a study's (``zfall.studies``);
- ``make`` of a stage (``zfall.training.makers``).
"""
