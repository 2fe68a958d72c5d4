"""How long the package took to import: part of every solution's account of time."""

import_seconds = 0.0
