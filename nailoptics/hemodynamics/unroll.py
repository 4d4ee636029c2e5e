"""Quick code from plain formulas: a function of lists of floats, run once on symbols, becomes code without loops.

An interpreter spends most of the time of a short loop on the loop, and a step in time is made of such loops.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any


class _Symbol:
    """Stands for a float while a function is unrolled: each operation on it becomes a line of code, once."""

    def __init__(self, name: str, found: dict[str, "_Symbol"]) -> None:
        self.name, self.found = name, found

    def __repr__(self) -> str:
        return self.name

    def write(self, code: str) -> "_Symbol":
        """The symbol of what a line of code gives."""
        return self.found.setdefault(code, _Symbol(f"v{len(self.found)}", self.found))

    def __neg__(self) -> "_Symbol":
        return self.write(f"-{self}")

    def __abs__(self) -> "_Symbol":
        return self.write(f"{self} if {self} > 0.0 else -{self}")


for _name, _sign in {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}.items():
    setattr(_Symbol, f"__{_name}__", lambda a, b, sign=_sign: a.write(f"{a} {sign} {b}"))
    setattr(_Symbol, f"__r{_name}__", lambda a, b, sign=_sign: a.write(f"{b} {sign} {a}"))


def larger(a: Any, b: Any) -> Any:
    """The larger of two numbers, in a function that may be unrolled."""
    for symbol in (a, b):
        if isinstance(symbol, _Symbol):
            return symbol.write(f"{a} if {a} > {b} else {b}")
    return a if a > b else b


def unroll(function: Callable[..., Any], *sizes: int | None) -> Callable[..., Any]:
    """The function for arguments of fixed sizes, compiled: the same operations in the same order.

    function : Takes lists of floats and floats, and works on them by + - * / abs and `larger` alone.
    sizes : Length of each argument that is a list; None for a float.
    """
    found: dict[str, _Symbol] = {}
    names = [f"a{position}" for position in range(len(sizes))]
    arguments: list[Any] = []
    unpacked = []
    for name, size in zip(names, sizes, strict=True):
        items = [_Symbol(f"{name}_{item}", found) for item in range(size or 0)]
        arguments.append(_Symbol(name, found) if size is None else items)
        unpacked += [] if size is None else [f"{items} = {name}"]
    result = function(*arguments)
    lines = [*unpacked, *_lines(found, str(result))]
    space: dict[str, Any] = {}
    exec("\n    ".join([f"def unrolled({', '.join(names)}):", *lines]), space)
    unrolled: Callable[..., Any] = space["unrolled"]
    return unrolled


def _lines(found: dict[str, _Symbol], result: str) -> Iterator[str]:
    """Lines of code that give every symbol used more than once, the others written out where they are used."""
    code_of = {symbol.name: code for code, symbol in found.items()}
    uses = Counter(name for code in [*found, result, result] for name in re.findall(r"\bv\d+", code))

    def written_out(code: str) -> str:
        return re.sub(r"\bv\d+", lambda match: in_place(match.group()), code)

    def in_place(name: str) -> str:
        return name if uses[name] > 1 else f"({written_out(code_of[name])})"

    yield from (f"{name} = {written_out(code)}" for name, code in code_of.items() if uses[name] > 1)
    yield f"return {result}"
