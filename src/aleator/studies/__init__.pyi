"""What running studies needs; see `__init__.py`. Modules are loaded at their first use."""

from ._check import Check as Check
from ._listed import STUDIES as STUDIES
from ._listed import importable as importable
from ._listed import load as load
from ._listed import schema as schema
from ._own import Study as Study
from ._own import SweptStudy as SweptStudy
from ._own import executor_of as executor_of
from ._own import problems_of as problems_of
from ._study import AbstractStudy as AbstractStudy
from ._study import Draft as Draft
