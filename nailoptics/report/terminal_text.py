"""Summaries of results as lines of text for the terminal."""

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..light import RestReadings
    from ..studies.comparison.compare import Verdict


def simulation_lines(summary: dict[str, Any]) -> list[str]:
    """The readings of a `simulation_summary` as a table."""
    spread = f" {'spread':>8}" if any("volts_start_spread" in row for row in summary["readings"]) else ""
    head = f"{'LED':>10} {'photodiode':<14} {'start V':>9} {'+-':>8}{spread} {'change mV':>10} {'+-':>7}{spread}"
    lines = [f"{head} {'peak mV':>9} {'noise mV':>9}"]
    for row in summary["readings"]:
        line = f"{row['led']:>10} {row['photodiode']:<14} {row['volts_start']:9.4f} "
        if row["saturated"]:
            line += "saturated: the converter is at its limit, these volts do not measure the light"
        else:
            line += f"{row['volts_start_stderr']:8.4f}" + (
                f" {row.get('volts_start_spread', math.nan):8.4f}" if spread else ""
            )
            line += f" {1e3 * row['volts_change']:10.3f} {1e3 * row['volts_change_stderr']:7.3f}"
            line += f" {1e3 * row.get('volts_change_spread', math.nan):8.3f}" if spread else ""
            line += f" {1e3 * row['volts_change_peak']:9.3f} {1e3 * row['volts_noise_rms']:9.4f}"
        lines.append(line)
    hold_s = summary["readings"][0]["time_of_change_s"]
    lines.append(
        f"start: the first sample; change: from there to the end of the hold, at {hold_s:.3g} s; peak: the largest one"
    )
    if spread:
        lines.append("+-: standard error of the trace; spread: one standard deviation over the priors of the finger")
    return [*lines, *absorbed_lines(summary.get("absorbed", {})), *summary.get("conclusions", [])]


def check_lines(report: dict[str, Any]) -> list[str]:
    """The report of `check` on a scene."""
    lines = [f"{report['scene']}: the scene is valid"]
    lines += [_led_line(led) for led in report.get("leds", ())]
    if "photodiodes" in report:
        u, v = report["board_mm"]
        of = f", and {report['not_wired']} that are not wired" if report["not_wired"] else ""
        lines.append(f"photodiodes: {len(report['photodiodes'])}{of}, on a board of {u:.3g} x {v:.3g} mm")
        lines += ["  LED to photodiode, place (u, v), distance, reading at rest by layered diffusion (within 40 %):"]
        places = {one["name"]: "({:.3g}, {:.3g}) mm".format(*one["position_mm"]) for one in report["photodiodes"]}
        lines += [
            f"  {one['led']:>10} to {name:<16} {places[name]:<18} {one['distance_mm']:5.2f} mm {one['volts']:8.4f} V"
            for one in report["pairs"]
            for name in [one["photodiode"]]
        ]
    for one in report.get("candidates", ()):
        lines.append(f"layout {one['name']}: {one['leds']} LEDs, {one['photodiodes']} photodiodes")
    lines += [f"{name}: {report[name]}" for name in ("touch", "blood", "body") if report.get(name)]
    for file, refs in report.get("ignored", {}).items():
        parts = "part" if len(refs) == 1 else "parts"
        shown = ", ".join(refs[:8]) + (", ..." if len(refs) > 8 else "")
        lines.append(f"ignored: {len(refs)} {parts} of {file} ({shown})" if refs else f"ignored: nothing of {file}")
    if "crossings" in report:
        names = ", ".join(name for name in report["regions"] if name != "air")
        lines += [
            f"geometry: {report['triangles']} triangles between the air and {names}",
            f"watertight: {'yes' if report['valid'] else 'NO'}; {report['disagreements']} of {report['crossings']} "
            "surface crossings of random rays enter another region than the surface bounds; volumes by surfaces and "
            f"by cells agree within {report['volume_error']:.0e} of the whole",
        ]
    lines += [f"warning: {line}" for line in report.get("warnings", ())]
    if report.get("two_balances_n"):
        low, high = report["two_balances_n"]
        lines.append(
            f"warning: between {low:g} and {high:g} N these vessels can rest in two states, so that unloading may "
            "end elsewhere than loading began; simulate follows them, steady states are the wider of the two"
        )
    return lines


def verdict_line(judged: "Verdict") -> str:
    """Whether a model holds over a sweep, how sure that is, and its largest error."""
    largest, low, high = (f"{100 * x:.3g}" for x in (judged.worst_error, judged.worst_low, judged.worst_high))
    name = {"taylor": "Taylor (9)", "beer_lambert": "Beer-Lambert (8)"}[judged.model]
    of = f"{100 * judged.tolerance:g} % of the swing of all {judged.readings} readings over the {judged.sweep}"
    confidence = "over 99.9" if judged.sure > 0.999 else f"{100 * judged.sure:.3g}"
    words = {
        "met": f"{name} stays within {of} ({confidence} % confidence)",
        "missed": f"{name} does not stay within {of} ({confidence} % confidence)",
        "undecided": f"Whether {name} stays within {of} is undecided; trace more photons",
    }
    where = f"LED {judged.led}, photodiode {judged.photodiode}"
    return f"{words[judged.outcome]}. Largest error: {largest} % (95 % interval {low} to {high} %), {where}."


def oximeter_lines(summary: dict[str, Any]) -> list[str]:
    """An oximeter's calibration and its error, photodiode by photodiode."""
    lines = [
        f"{'photodiode':<14} {'SpO2 in percent':<20} {'R at rest':>9} {'+-':>7} {'path ratio':>10} {'error, 8 s':>10}"
    ]
    for name, one in summary["readings"].items():
        fit, rest = one["fit"], one["ratio_at_rest"]
        line = f"{fit['intercept']:.1f} - {-fit['slope']:.1f} R"
        lines.append(
            f"{name:<14} {line:<20} {rest['value']:9.4f} {rest['stderr']:7.4f} {one['path_ratio']:10.3f} "
            f"{one['spo2_stderr']:8.2f} %"
        )
    best = summary["readings"][summary["best"]]
    index = ", ".join(f"{led} {100 * value:.3f} %" for led, value in best["perfusion_index"].items())
    lines.append(f"best photodiode: {summary['best']}; perfusion index {index}")
    for name, one in best["disturbances"].items():
        worst = max(one["spo2_off"], key=abs)
        lines.append(f"  {name} from {one['values'][0]:g} to {one['values'][-1]:g}: bias at most {worst:+.2f} %")
    return lines


def oxygen_lines(summary: dict[str, Any]) -> list[str]:
    """SpO2, pulse rate and motion of an oximeter's recording, photodiode by photodiode."""
    lines = []
    for name, one in summary["readings"].items():
        spo2 = "SpO2 unknown"
        if one["spo2"] is not None:
            spo2 = f"SpO2 {one['spo2']:.1f} % ({one['spo2_low']:.1f} to {one['spo2_high']:.1f})"
        rate = "rate unknown" if one["rate_per_min"] is None else f"{one['rate_per_min']:.1f} beats a minute"
        motion = f"motion in {100 * one['motion']:.0f} % of the time"
        lines.append(f"{name:<14} {spo2}, {rate}, {motion}{', best' if name == summary['best'] else ''}")
    return lines


def _led_line(led: dict[str, Any]) -> str:
    part = f" ({led['part']})" if "part" in led else ""
    (u, v), width = led["position_mm"], f", {led['fwhm_nm']:g} nm wide" if led["fwhm_nm"] else ""
    return f"LED {led['name']}{part}: {led['wavelength_nm']:g} nm{width}, {led['flux_mw']:g} mW, at ({u:g}, {v:g}) mm"


def rest_lines(rest: "RestReadings") -> list[str]:
    """The readings of a trace, and where its light went."""
    lines = []
    for row in rest.readings:
        error = _plus_minus(row["stderr"], ".1e")
        if "upper_limit_95" in row:
            error = f"below {row['upper_limit_95']:.1e} (95 %)"
        lines.append(f"{row['led']:>10} {row['photodiode']:<16} {row['detected_fraction']:.4e} {error}")
    for part, share in (rest.energy or {}).items():
        lines.append(f"{part:>11} {share['value']:.5f} {_plus_minus(share['stderr'], '.5f')}")
    lines += absorbed_lines(rest.transfer.absorbed()) if rest.transfer else []
    return lines + ([rest.note] if rest.note else [])


def absorbed_lines(absorbed: dict[str, dict[str, dict[str, float]]]) -> list[str]:
    """Where each LED's absorbed light ended, the largest part first, with the largest standard error."""
    lines = []
    for led, regions in absorbed.items():
        parts = sorted(((part["value"], name) for name, part in regions.items() if part["value"] > 0), reverse=True)
        if parts:
            error = 100 * max(part["stderr"] for part in regions.values())
            each = ", ".join(f"{name} {100 * value:.2f} %" for value, name in parts)
            lines.append(f"{led:>10} absorbed in {each} ({_plus_minus(error, '.2f')} % or less)")
    return lines


def _plus_minus(stderr: float, form: str) -> str:
    return "+- unknown" if math.isnan(stderr) else f"+- {stderr:{form}}"


def placement_lines(summary: dict[str, Any]) -> list[str]:
    """The ranking of a `placement_summary` as a table, best first."""
    from ..studies.placement.result import rough_words

    lines = [
        f"{row['rank']:>3} {row['layout']:<28} {1e3 * row['force_resolution_n']:9.3f} mN "
        f"+- {1e3 * row['force_resolution_n_stderr']:.3f}{_still(row)}{_spread(row)}{_oxygen(row)}"
        f"{_share(row, summary['rank_by'])}{'  tied' if row['tied'] else ''}"
        for row in summary["ranking"]
    ]
    if better := summary["gain_over_paper"]:
        times = f"{better['value']:.2f} +- {better['stderr']:.2f} times"
        tied = sum(row["tied"] for row in summary["ranking"])
        beside = f"; {tied} layouts are tied with each other" if tied else ""
        lines.append(f"force resolution better than the paper's layout: {times}{beside}")
    if rough := rough_words(summary["ranking"]):
        lines.append(rough)
    return [*lines, *summary.get("conclusions", [])]


def _still(row: dict[str, Any]) -> str:
    """The resolution limited by the electronics and the rank by it, where the scene has a body."""
    if "electronics_rank" not in row:
        return ""
    value, error = (1e3 * row[f"electronics_resolution_n{end}"] for end in ("", "_stderr"))
    return f", electronics alone {value:.3f} mN +- {error:.3f} (rank {row['electronics_rank']})"


def _oxygen(row: dict[str, Any]) -> str:
    """The error of SpO2, where that ranks layouts."""
    if "spo2_error_percent" not in row:
        return ""
    return f", SpO2 {row['spo2_error_percent']:.3f} % +- {row['spo2_error_percent_stderr']:.3f}"


def _share(row: dict[str, Any], rank_by: str) -> str:
    """The resolution of the proximal share of the force, where that ranks layouts."""
    if "share" not in rank_by:
        return ""
    return f", share {100 * row['share_resolution']:.3f} % +- {100 * row['share_resolution_stderr']:.3f}"


def _spread(row: dict[str, Any]) -> str:
    """The standard deviation of a layout's resolution over the priors, where that is known."""
    spread_n = row.get("force_resolution_spread_n", math.nan)
    if math.isnan(spread_n):
        return ""
    return f", spread {1e3 * spread_n:.3f} +- {1e3 * row['force_resolution_spread_n_stderr']:.3f}"


def colour_lines(summary: dict[str, Any]) -> list[str]:
    """The same in a few lines for a terminal: the middle of the nail under each force."""
    lines = ["force [N]  L*     a*     b*     difference to rest  white band [mm]"]
    for state in summary["states"]:
        middle = state["places"][len(state["places"]) // 2]
        lab = "  ".join(f"{value:5.1f}" for value in middle["lab"])
        most = max(place["delta_e_2000"] for place in state["places"])
        lines.append(f"{state['force_n']:<9g}  {lab}  {most:<18.1f}  {state['white_band_mm']:.1f}")
    errors = summary["colour_stderr"], summary["change_stderr"]
    lines.append("standard error of a place's colour at most {:.2g}, of a change {:.2g} (CIEDE2000)".format(*errors))
    if summary["refill_s"] is not None:
        lines.append(f"colour as at rest {summary['refill_s']:.3g} +- {summary['refill_stderr_s']:.1g} s after release")
    if "lab_spread" in summary:
        each = "  ".join(f"{value:.1f}" for value in summary["lab_spread"]["nail"])
        lines.append(f"standard deviation of the nail's L*, a*, b* over the priors of the finger: {each}")
    return lines
