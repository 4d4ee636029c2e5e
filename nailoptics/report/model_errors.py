"""What explain and tradeoff come to: as JSON, and as lines for the terminal."""

import math
from dataclasses import asdict
from typing import Any

from ..studies.model_error.changes import lines_of, merged
from ..studies.model_error.explain import Effect, Explanation
from ..studies.model_error.tradeoff import OWN, REFERENCE, Answer, Bias, Level, Tradeoff

# Errors for which the fastest answer is reported, and those that the sentence for a designer names.
ERRORS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001)
SENTENCE_ERRORS = (0.2, 0.05, 0.01, 0.001)
ERROR_OF = "of the reading at rest, or of the change by touch as a part of the largest change of any photodiode"


def duration(seconds: float) -> str:
    """A time in the unit that suits it."""
    units = (("h", 3600.0, 5400.0), ("min", 60.0, 90.0), ("s", 1.0, 1.0), ("ms", 1e-3, 1e-3), ("us", 1e-6, 0.0))
    name, size = next((unit, size) for unit, size, least in units if seconds >= least)
    return f"{seconds / size:.{0 if seconds >= 100 * size else 2}{'f' if seconds >= 100 * size else 'g'}} {name}"


def percent(value: float, stderr: float) -> str:
    """A part and its standard error in percent, both to two digits of the error; what is 0 by construction has none."""
    if not stderr > 0:
        return f"{100 * value:+.2g}%" if value else "0%"
    decimals = min(max(1 - math.floor(math.log10(100 * stderr)), 0), 5) if math.isfinite(stderr) else 2
    return f"{100 * value:+.{decimals}f} +- {100 * stderr:.{decimals}f}%"


def _percent(part: float) -> str:
    return f"{100 * part:.2g}%" if part < 1 else f"{100 * part:.0f}%"


def effect_name(effect: Effect) -> str:
    """Its name, and what it moves where that is not the reading."""
    return effect.name + (" (of the signal)" if effect.of == "signal" else "")


def explanation_summary(found: Explanation) -> dict[str, Any]:
    """Everything, ready for JSON."""

    def row(effect: Effect) -> dict[str, Any]:
        return vars(effect) | {"matters": effect.matters, "lines": effect.lines}

    return {
        "effects": [row(e) for e in found.effects],
        "not_needed": [e.name for e in found.needless],
        "missing": [e.name for e in found.missing],
        "together": found.together and row(found.together),
    } | {name: getattr(found, name) for name in ("tolerance", "photons", "backend", "wall_seconds", "cut_off")}


def explanation_lines(found: Explanation) -> list[str]:
    """The table of effects and what the scene requires, for the terminal."""
    head = f"{'effect':<26} {'in scene':<8} {'reading moves':>18} {'of':<16} "
    head += f"{'all at most':>11} {'signal':>8}  matters"
    lines = [f"Cut off: {found.cut_off}"] if found.cut_off else []
    lines += [f"Changes of a reading by more than {100 * found.tolerance:g} % matter.", head]
    for e in (*found.effects, *([found.together] if found.together else [])):
        signal = "-" if e.modulation_bound is None else _percent(e.modulation_bound)
        known, modelled = math.isfinite(e.change), "unknown" if e.unknown else "yes" if e.modelled else "no"
        moved = percent(e.change, e.stderr) if known else "not known"
        of = e.photodiode + (" (signal)" if e.of == "signal" else "") if known else ""
        text = f"{e.name:<26} {modelled:<8} {moved:>18} {of:<16} "
        lines.append(f"{text}{_percent(e.bound):>11} {signal:>8}  {e.matters:<11} {e.changed_to}")
    if found.needless:
        lines.append("Not needed each by itself; these scene lines leave all of it out:")
        lines += [*(f"  {line}" for line in lines_of(merged(found.needless)))]
        if found.together:
            moved = f"moves a reading by at most {_percent(found.together.bound)}"
            lines.append(f"Leaving all of these out at once {moved}, all photodiodes, 95 % sure.")
    if found.missing:
        lines.append("Left out, though it matters: " + ", ".join(map(effect_name, found.missing)))
    if any(e.matters == "cannot tell" for e in found.effects):
        lines.append("What is not resolved needs more photons: --max-seconds, --photons or --relative-error.")
    return lines


def meaning(found: Tradeoff) -> str:
    """What the tolerance is the error of, in words."""
    part = f"{100 * found.tolerance:g} %"
    if found.simultaneous:
        return f"all readings at rest and all changes by touch, of the largest, within {part} with 95 % probability"
    return f"{part} as one standard error of the worst photodiode, {ERROR_OF}"


def sentence(found: Tradeoff) -> str:
    """What a designer needs: how long each error takes."""
    answers = [found.fastest(error) for error in SENTENCE_ERRORS]
    every = f"For {100 * SENTENCE_ERRORS[0]:g} %"
    full = all(answer and answer.level.name in (OWN, REFERENCE) for answer in answers)
    parts: list[str] = []
    for error, answer in zip(SENTENCE_ERRORS, answers, strict=True):
        how = "no level" if not answer else duration(answer.seconds) + ("" if full else f" ({answer.level.name})")
        parts.append(f"{every if not parts else f'for {100 * error:g} %'} {how}")
    start = "Time is photons: no simpler level is faster at any of these errors. " if full else ""
    return f"{start}{', '.join(parts)}."


def simultaneous_line(found: Tradeoff) -> str:
    """What it takes to hold all readings and changes to the tolerance at once; empty where it is that already."""
    other = found.fastest(found.tolerance, simultaneous=True)
    if found.simultaneous or other is None or not other.photon_seconds:
        return ""
    part = f"All readings and changes within {100 * found.tolerance:g} % at once, with 95 % probability"
    times = f"{found.coverage_factor**2:.1f} times the photons of one standard error"
    return f"{part} ({times}): {duration(other.seconds)}, {other.level.name}."


def tradeoff_summary(found: Tradeoff) -> dict[str, Any]:
    """Everything, ready for JSON."""
    kept = ("tolerance", "simultaneous", "wall_seconds", "cut_off", "lines", "coverage_factor")
    return (
        {name: getattr(found, name) for name in kept}
        | {name: found.attributes[name] for name in ("digest", "photons")}
        | {"chosen": found.chosen.level.name, "answer": _answer(found.chosen), "sentence": sentence(found)}
        | {"levels": [_level(found, one) for one in found.levels]}
        | {"fastest_within": {str(error): _answer(found.fastest(error)) for error in ERRORS}}
    )


def _answer(answer: Answer | None) -> dict[str, Any] | None:
    if answer is None:
        return None
    kept = {"photon_seconds": answer.photon_seconds, "error": answer.error, "first_seconds": answer.seconds}
    return {"level": answer.level.name, **kept, "relative_error": answer.relative_error}


def _level(found: Tradeoff, level: Level) -> dict[str, Any]:
    row = asdict(level) | {"lines": level.lines, "changes": level.changes or {}}
    row["first"] = {"fixed": row.pop("setup_seconds"), "per_second": float(level.traces)}
    return row | {"within_tolerance": _answer(level.within(found.tolerance, found.coverage))}


def time_within(found: Tradeoff, level: Level) -> str:
    """The time of a level's answer within the tolerance, or "-"."""
    answer = level.within(found.tolerance, found.coverage)
    return duration(answer.seconds) if answer else "-"


def chosen_line(found: Tradeoff) -> str:
    """The level to take."""
    if math.isinf(found.chosen.error):
        return f"Too few photons to judge any level: take {found.chosen.level.name}."
    answer = f"{found.chosen.level.name}, {duration(found.chosen.seconds)} of processor time"
    return f"Fastest within the tolerance: {answer}."


def tradeoff_lines(found: Tradeoff) -> list[str]:
    """The table of levels and the one to take, for the terminal."""
    lines = [f"Cut off: {found.cut_off}"] if found.cut_off else []
    lines.append(
        f"{'level':<26} {'reading off by':>18} {'at most':>8} {'signal off by':>18} {'at most':>8} {'answer':>10}"
    )
    lines += [
        f"{one.name:<26} {_bias(one.reading)} {_bias(one.signal)} {time_within(found, one):>10}  {one.beforehand}"
        for one in found.levels
    ]
    lines += [f"Tolerance: {meaning(found)}.", chosen_line(found), sentence(found)]
    lines += filter(None, [simultaneous_line(found)])
    return [*lines, *selection(found)]


def selection(found: Tradeoff) -> list[str]:
    """How the chosen level is selected."""
    if found.chosen.level.call:
        return [f"No line of a scene selects it: {found.chosen.level.call} gives it."]
    if found.lines:
        return ["Scene lines that select it:", *(f"  {line}" for line in found.lines)]
    return ["The scene is that already: no line needs to change."]


def _bias(bias: Bias | None) -> str:
    if bias is None:
        return f"{'not measured':>18} {'':>8}"
    text = percent(bias.value, bias.stderr) if math.isfinite(bias.value) else "not known"
    return f"{text:>18} {bias.bound:>8.1%}"
