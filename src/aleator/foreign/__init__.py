"""Models that come from elsewhere: SymPy, FMUs, files of robots, black boxes; and our problems in OpenMDAO.

Listed in `__init__.pyi`, and loaded at its first use: a process that runs an FMU needs little of it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
