"""The package's face: what `import aleator` shows and what it loads."""

import pkgutil
import subprocess
import sys
import types

import aleator as al


def test_no_public_name_hides_a_module():
    hidden = [
        module.name
        for module in pkgutil.iter_modules(al.__path__)
        if not isinstance(getattr(al, module.name, types), types.ModuleType)
    ]
    assert hidden == []


def test_what_few_programs_need_is_not_loaded_with_the_package():
    late = [
        "scipy.stats",
        "scipy.optimize",
        "scipy.interpolate",
        "plotly",
        "pandas",
        "casadi",
        "typer",
        "h5py",
        "diffrax",
    ]
    script = f"import sys, aleator; print([name for name in {late} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert found.stdout.strip() == "[]"
