"""What running studies needs; see `__init__.py`. Modules are loaded at their first use."""

from ._check import Check as Check
from ._listed import STUDIES as STUDIES
from ._listed import load as load
from ._listed import load_file as load_file
from ._listed import load_module as load_module
from ._own import Study as Study
from ._study import AbstractStudy as AbstractStudy
from ._study import Draft as Draft
from ._swept import SweptStudy as SweptStudy
from ._swept import executor_of as executor_of
from ._swept import problems_of as problems_of
from ._toml import load_toml as load_toml
from ._toml import schema as schema
