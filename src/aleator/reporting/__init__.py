"""Reports: figures, a self-contained HTML page, and files of results, made from result objects only.

Listed in `__init__.pyi`, and loaded at its first use: a journal that locks a folder needs no figures.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
