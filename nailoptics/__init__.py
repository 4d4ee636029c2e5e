"""nailoptics: an optical sensor on a fingernail, simulated from touch force to photodiode volts."""

import importlib
import inspect
import re
import sys
from pathlib import Path
from typing import Any

from .version import __version__ as __version__

# Where each public name lives, as the stub for type checkers says: `import nailoptics` imports none of them.
_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_HOMES = {name: home for home, name in re.findall(r"^from (\S+) import ([^_]\w+) as", _STUB, re.MULTILINE)}
__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if _HOMES[name] == ".":
        return importlib.import_module(f".{name}", __name__)
    found = getattr(importlib.import_module(_HOMES[name], __name__), name)
    if "xarray" in sys.modules:  # results show themselves by `result.nail`
        importlib.import_module(".report.accessor", __name__)
    if inspect.isfunction(found):
        from .options import spell_out

        spell_out(found)
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
