"""Variables of a Dataset under the CF conventions: dimensions, values, units, a name in words, and a standard error."""

from typing import Any

import numpy as np

Variable = tuple[tuple[str, ...], np.ndarray, dict[str, str]]
Variables = dict[str, Variable]


def variable(
    name: str, dims: str | tuple[str, ...], values: Any, long_name: str, *, units: str = "1", stderr: Any = None
) -> Variables:
    """A variable by its name, with its standard error beside it as NAME_stderr if it has one.

    Joined by |, several make the first argument of `xarray.Dataset`.
    """
    dims = (dims,) if isinstance(dims, str) else dims
    attributes = {"units": units, "long_name": long_name}
    if stderr is None:
        return {name: (dims, np.asarray(values), attributes)}
    beside = {"units": units, "long_name": f"standard error: {long_name}"}
    return {
        name: (dims, np.asarray(values), attributes | {"ancillary_variables": f"{name}_stderr"}),
        f"{name}_stderr": (dims, np.asarray(stderr), beside),
    }
