"""The time that the import of the package took, part of every solution's times."""

import_seconds = 0.0
