"""What tests of a whole placement share."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

from nailoptics.light.finger_walk import FingerTracer
from nailoptics.studies.placement import inspection, over_unknowns


@pytest.fixture(scope="session")
def fewer_photons() -> Callable[[], AbstractContextManager[None]]:
    """Lets a placement look at its best layout, and at what is unknown of the finger, with a quarter of the photons.

    Each number's error grows with that, and tests that compare two of them bound those errors, too.
    """

    @contextmanager
    def fewer() -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(FingerTracer, "batch_photons", FingerTracer.batch_photons // 4)
            patch.setattr(inspection, "BACK_PHOTONS", inspection.BACK_PHOTONS // 4)
            patch.setattr(over_unknowns, "BLOCK_PHOTONS", over_unknowns.BLOCK_PHOTONS // 4)
            yield

    return fewer
