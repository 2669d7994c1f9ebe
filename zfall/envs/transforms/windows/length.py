"""How long a window is."""


def window_steps(seconds: float, control_dt: float) -> int:
    """Control steps of a window of so many seconds.

    Raises:
        ValueError: if that is not at least one.
    """
    steps = round(seconds / control_dt)
    if steps < 1:
        raise ValueError(f"seconds must be at least control_dt {control_dt}, got {seconds}.")
    return steps
