"""The case studies. Each is a package that reads like its chapter, with running and presentation in separate modules.

    __init__    the physics and the problems
    _run        the computations: stages and their results
    _facts      numbers and tables of the results; what to build, and why
    _study      the chapters of the page, a scheme of the system, and the declaration that joins these, as any study is
                declared (`docs/extending.md`)

The command line finds them by name. What runs, saves and shows them is listed in `__init__.pyi` and loaded at its first
use: whoever wants the physics alone does not wait for it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
