"""A calibration reports how far its fit is, and ends where it is interrupted."""

from contextlib import nullcontext

import made_sensor
import pytest

from nailoptics.light import TraceProgress
from nailoptics.studies.force.calibrate import calibrate_with


@pytest.mark.long
def test_a_fit_reports_its_progress_and_can_be_interrupted() -> None:
    recordings, estimated = [made_sensor.record(made_sensor.cycle(1.5), "distal", seed=2)], list[TraceProgress]()
    calibrate_with(made_sensor.scene(), made_sensor.table(), recordings, progress=estimated.append)
    done = [one.fraction_done for one in estimated]
    assert len(done) > 5 and done == sorted(done) and (done[0], done[-1]) == (0.0, 1.0)
    assert all(one.is_stage and one.led == "fit" for one in estimated)

    # Within the first search, too; once the subject is there it is kept.
    for at in (0.0, 1.0):

        def interrupting(progress: TraceProgress, at: float = at) -> None:
            estimated.append(progress)
            if progress.fraction_done == at and len(estimated) > 1:
                raise KeyboardInterrupt

        estimated.clear()
        with pytest.raises(KeyboardInterrupt, match="no subject was written") if at < 1 else nullcontext():
            calibrate_with(made_sensor.scene(), made_sensor.table(), recordings, progress=interrupting)
        assert len(estimated) == (2 if at < 1 else len(done))
