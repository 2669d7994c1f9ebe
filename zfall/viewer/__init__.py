"""Robots in the browser, live: pushed, paused and swapped by hand (``recipes.view``)."""
