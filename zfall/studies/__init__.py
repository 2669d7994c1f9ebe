"""Studies: rows that differ in one thing, over seeds, tested in the same trials.

``study`` is the face, ``plan`` composes every run, ``execute`` trains and tests one, ``tables``
has the statistics and ``writers`` the files. ``tested_with`` is the hook for policies that are
tested together with others.
"""

from zfall.studies.study import Study

__all__ = ["Study"]
