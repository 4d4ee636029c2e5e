"""What tests of a whole placement share."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from nailoptics.light.board_map import BoardTracer
from nailoptics.studies.placement import verification


@pytest.fixture(scope="session")
def fewer_photons(shared_store: Path) -> Callable[[], AbstractContextManager[None]]:
    """Lets a placement look at its best layout, and at what is unknown of the finger, with a quarter of the photons.

    Each number's error grows with that, and tests that compare two of them bound those errors, too.
    """

    @contextmanager
    def fewer() -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("NAILOPTICS_STORE", str(shared_store))
            patch.setattr(BoardTracer, "batch_photons", BoardTracer.batch_photons // 4)
            patch.setattr(verification, "PHOTONS", verification.PHOTONS // 2)
            yield

    return fewer
