"""The case studies. Each is a package that reads like its chapter.

    __init__    the physics and the problems
    _chapter    the study from top to bottom: it solves, samples and sweeps, and appends what it finds to the page
    *.svg       a drawing of the system

The command line finds them by name. What runs, saves and shows them is listed in `__init__.pyi` and loaded at its first
use: whoever wants the physics alone does not wait for it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
