"""From a declared problem to a nonlinear program.

Parts are listed in `__init__.pyi` and loaded at their first use: who simulates does not wait for collocation.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
