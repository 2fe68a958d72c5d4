"""Study files: TOML that names a problem and overrides its numbers, checked at the border."""

from typing import Any

from aleator.studies._toml._load import load_toml as load_toml


def schema() -> dict[str, Any]:
    """The JSON Schema of study files, by which editors complete them."""
    from aleator.studies._toml._schema import StudyFile  # pydantic is imported late

    return StudyFile.model_json_schema()
