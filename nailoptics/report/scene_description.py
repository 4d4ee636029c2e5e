"""What a scene asks for, in words: its touch, its blood and its body."""

from ..scene import Scene

_PULP = {1.0: "on the proximal pulp", 0.0: "on the distal pulp", 0.5: "even"}


def touch_words(scene: Scene) -> str:
    """The touch of a scene."""
    touch = scene.touch
    steps = [step.force_n for step in touch.steps or ()]
    words = {
        "step": f"step of {touch.force_n:g} N",
        "ramp": f"ramp to {touch.force_n:g} N",
        "hold": f"hold of {touch.force_n:g} N",
        "cycle": f"{touch.cycles} cycles ({touch.waveform}) of {touch.force_n:g} N and {touch.period_s or 0:g} s",
        "steps": f"{len(steps)} steps of force, up to {max(steps, default=0):g} N",
        "recorded": f"recorded in {touch.file}",
    }[touch.profile]
    if touch.recorded_proximal_pressure_pa is None:
        share = f"{100 * touch.proximal_share:g} % of it on the proximal pulp"
        words += f", {_PULP.get(touch.proximal_share, share)}"
    else:
        words += ", as pressures on both sides"
    if touch.recorded_shear_n is not None or touch.shear_n:
        words += ", with shear" if touch.shear_n is None else f", with {touch.shear_n:g} N of shear"
    return words


def blood_words(scene: Scene) -> str:
    """The vessels of a scene, its zones and its oxygen."""
    blood = scene.blood
    words = f'vessels "{blood.parameters}"'
    if blood.tuning is not None and blood.tuning.changed():
        own = blood.tuning.model_dump(exclude_none=True, exclude={"factors"})
        changes = [f"{name} = {value:g}" for name, value in own.items()]
        changes += [f"{name} times {factor:g}" for name, factor in (blood.tuning.factors or {}).items()]
        words += f" with {', '.join(changes)}"
    zones = len(scene.zone_edges_mm) + 1
    if zones > 2 or blood.decay_length is not None:
        words += f", {zones} zones along the nail"
    if blood.venous_so2 is None:
        return words + f", {100 * blood.so2:g} % saturated"
    return words + f", {100 * blood.so2:g} % saturated in arteries and {100 * blood.venous_so2:g} % in veins"


def body_words(scene: Scene) -> str:
    """What moves readings of a scene beside the touch; empty where nothing does."""
    body = scene.body
    if body is None:
        return ""
    parts = []
    if body.recorded_time_s is not None:
        parts.append(f"arterial pressure recorded in {body.file}")
    if body.heartbeat is not None:
        parts.append(f"heartbeat, {body.heartbeat.rate_per_min:g} a minute")
    if body.breathing is not None:
        parts.append(f"breathing, {body.breathing.rate_per_min:g} a minute")
    if body.vasomotion is not None:
        parts.append("vasomotion")
    if body.drift is not None:
        parts.append("drift")
    if body.motion is not None:
        parts.append("motion of the sensor")
    return ", ".join(parts)
