"""nailoptics: an optical sensor on a fingernail, simulated from touch force to photodiode volts."""

import importlib
from typing import Any

from .display import Displayed, show_datasets

# Where each public name lives, as the stub for type checkers says, line by line: `import nailoptics` imports none.
with open(f"{__file__}i", encoding="utf-8") as _stub:
    _WORDS = [line.split() for line in _stub if line.startswith("from .")]
_HOMES = {name: home for _, home, _, name, *_ in _WORDS} | {"scene": "."}
__all__ = [name for name in _HOMES if name != "__version__"]

Displayed.accessor = lambda shown: importlib.import_module(".report.accessor", __name__).Nail(shown)
show_datasets()


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if _HOMES[name] == ".":
        return importlib.import_module(f".{name}", __name__)
    attribute = getattr(importlib.import_module(_HOMES[name], __name__), name)
    if callable(attribute) and not isinstance(attribute, type):
        from .options import spell_out

        spell_out(attribute)
    return attribute


def __dir__() -> list[str]:
    return [*_HOMES]
