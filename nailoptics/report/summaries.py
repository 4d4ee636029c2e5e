"""The summary of every result as plain numbers and texts, ready for JSON."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .readings import hold_end, photodiode_readings
from .uncertainty_section import spread_summary

if TYPE_CHECKING:
    import xarray as xr


def simulation_summary(result: "xr.Dataset") -> dict[str, Any]:
    """Volts at the start, their change to the end of the hold, the largest change, and their noise."""
    rows = [
        {
            "led": r.led,
            "photodiode": r.photodiode,
            "volts_start": r.rest_v,
            "volts_start_stderr": r.rest_stderr_v,
            "volts_change": r.change_v,
            "volts_change_stderr": r.change_stderr_v,
            "volts_change_peak": r.peak_v,
            "volts_change_peak_stderr": r.peak_stderr_v,
            "time_of_peak_s": r.peak_s,
            "volts_noise_rms": r.noise_rms_v,
            "time_of_change_s": float(result.time[hold_end(result)]),
            "saturated": r.saturated,
        }
        | {
            name: float(result[name][r.led_index, r.photodiode_index])
            for name in ("beer_lambert_residual_rms_v", "taylor_residual_rms_v")
        }
        | {f"volts_{name}": value for name, value in r.spreads_v.items()}
        for r in photodiode_readings(result, None)
    ]
    kept = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest", "accuracy_reached")
    found = {"readings": rows, "absorbed": _absorbed(result)} | spread_summary(result)
    # volpath keeps no light.
    found["reused"] = bool(result.attrs.get("reused", 0))
    return found | {name: result.attrs[name] for name in kept}


def _absorbed(result: "xr.Dataset") -> dict[str, dict[str, dict[str, float]]]:
    """Where each LED's absorbed light ended; nothing where that was not traced."""
    if "absorbed_fraction" not in result:
        return {}
    names = {"value": "absorbed_fraction", "stderr": "absorbed_fraction_stderr"}
    return {
        str(led): {
            str(region): {key: float(result[name].sel(led=led, region=region)) for key, name in names.items()}
            for region in result.region.values
        }
        for led in result.led.values
    }


def placement_summary(result: "xr.Dataset") -> dict[str, Any]:
    """The ranking of layouts, and the gain in force resolution over the paper's layout."""
    from ..studies.placement.result import gain, rows

    better = gain(result)
    kept = ("photons", "cpu_seconds", "wall_seconds", "digest", "rank_by")
    return {
        "ranking": rows(result),
        "gain_over_paper": {"value": better[0], "stderr": better[1]} if better else None,
        "checked_resolution_n": result.attrs.get("checked_resolution_n"),
        "cut_off": result.attrs.get("cut_off"),
        **spread_summary(result),
    } | {name: result.attrs[name] for name in kept}


def comparison_summary(result: "xr.Dataset") -> dict[str, Any]:
    """A comparison: readings by sweep, LED and photodiode, and the paper's claim."""
    places = np.ndindex(*(result.sizes[name] for name in _COMPARISON_DIMS))
    rows = [_comparison_row(result.isel(dict(zip(_COMPARISON_DIMS, at, strict=True)))) for at in places]
    kept = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest")
    found = {"comparisons": rows, "claim": paper_claim(result), "cut_off": result.attrs.get("cut_off")}
    found |= {"reused": bool(result.attrs.get("reused", 0))}
    return found | {name: result.attrs[name] for name in kept}


_COMPARISON_DIMS = ("sweep", "led", "photodiode")


_ALPHA_D2 = ("alpha_d2", "bed_alpha_d2")


def _comparison_row(one: "xr.Dataset") -> dict[str, Any]:
    """One photodiode under one LED over one sweep."""
    row: dict[str, Any] = {name: str(one[name].values) for name in _COMPARISON_DIMS}
    row |= {"swing_of_reading": float(one.swing / one.reading[0]), "path_mm": _with_stderr(one, "path_mm")}
    for name in _ALPHA_D2:
        row |= {f"{name}_{end}": _with_stderr(one.isel(point=at), name) for end, at in (("start", 0), ("end", -1))}
    for way in (str(w) for w in one.way.values):
        for model in (str(m) for m in one.model.values):
            here = one.sel(way=way, model=model)
            error = _with_stderr(here.isel(point=-1), "range_error")
            limits = {f"{within:g}": _comparison_limit(here.sel(within=within)) for within in one.within.values}
            row[f"{model}_{way}"] = {"error_of_swing": error, "holds_to": limits}
        worst = int(np.abs(one.error.sel(way=way, model="taylor").values).argmax())
        parts = one.sel(way=way).isel(point=worst)
        row[f"parts_{way}"] = {str(p): _with_stderr(parts.sel(part=p), "part_error") for p in one.part.values}
    return row


def _comparison_limit(here: "xr.Dataset") -> dict[str, Any]:
    """Up to where a model holds, in every measure."""
    limits: dict[str, Any] = {"ends_within_sweep": bool(here.limit_ends)}
    for name in ("setting", "blood_fraction", *_ALPHA_D2):
        limit = "limit" if name == "setting" else f"limit_{name}"
        limits[name] = {"value": float(here[limit])} | {end: float(here[f"{limit}_{end}"]) for end in ("low", "high")}
    return limits


def paper_claim(result: "xr.Dataset") -> dict[str, Any]:
    """How large alpha D^2 is over the first sweep, beside the paper's 1e-2."""
    first = result.isel(sweep=0)
    found: dict[str, Any] = {"paper": 0.01, "sweep": str(result.sweep.values[0])}
    for name in _ALPHA_D2:
        start, error = first[name].isel(point=0), first[f"{name}_stderr"].isel(point=0)
        found[name] = {
            "at_start": {"least": float(start.min()), "largest": float(start.max()), "stderr": float(error.max())},
            "over_sweep": {"least": float(first[name].min()), "largest": float(first[name].max())},
        }
    return found


def _with_stderr(one: "xr.Dataset", name: str) -> dict[str, float]:
    """A value and its standard error."""
    return {"value": float(one[name]), "stderr": float(one[f"{name}_stderr"])}


def colour_summary(result: "xr.Dataset") -> dict[str, Any]:
    """Colours by force and place, with the largest standard errors, refill and spread over priors."""
    states = []
    for s, force_n in enumerate(result.force_n.values):
        one = result.isel(state=s)
        places = [
            {
                "v_mm": float(one.v_mm[p]),
                "lab": one.lab.values[p].tolist(),
                "lab_stderr": one.lab_stderr.values[p].tolist(),
                "srgb": one.srgb.values[p].tolist(),
                "delta_e_2000": float(one.delta_e_2000[p]),
                "delta_e_2000_stderr": float(one.delta_e_2000_stderr[p]),
            }
            for p in range(result.sizes["place"])
        ]
        band = {"white_band_mm": float(one.white_band_mm), "white_band_stderr_mm": float(one.white_band_mm_stderr)}
        states.append({"force_n": float(force_n), "places": places, **band})
    found: dict[str, Any] = {
        "illuminant": result.attrs["illuminant"],
        "observer": result.attrs["observer"],
        "states": states,
        "lab_stderr": result.lab_stderr.max(("place", "state")).values.tolist(),
        "colour_stderr": float(result.colour_stderr.max()),
        "change_stderr": float(result.delta_e_2000_stderr.max()),
    }
    found["refill_s"] = found["refill_stderr_s"] = None
    if "refill_s" in result and not np.isnan(result.refill_s).all():
        slowest = result.isel(place=int(np.nanargmax(result.refill_s)))
        found |= {"refill_s": float(slowest.refill_s), "refill_stderr_s": float(slowest.refill_s_stderr)}
    if "beat_delta_e_2000" in result:
        moved = result.isel(place=int(np.argmax(result.beat_delta_e_2000.values)))
        found["beat_delta_e_2000"] = float(moved.beat_delta_e_2000)
        found["beat_delta_e_2000_stderr"] = float(moved.beat_delta_e_2000_stderr)
    if "lab_spread" in result:
        spread = result.lab_spread.transpose("site", "band").values.tolist()
        found["lab_spread"] = dict(zip(result.site.values.tolist(), spread, strict=True))
    return found | {name: result.attrs[name] for name in ("photons", "backend", "cpu_seconds", "wall_seconds")}


def oximeter_summary(result: "xr.Dataset") -> dict[str, Any]:
    """Calibration and errors of an oximeter; so2 in parts of 1, everything called SpO2 in percent."""
    scene_so2, leds = float(result.attrs["so2"]), [str(name) for name in result.led.values]
    readings = {}
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        terms, errors = one.linear.values.tolist(), one.linear_stderr.values.tolist()
        readings[str(name)] = {
            "so2": one.so2.values.tolist(),
            "ratio": one.ratio.values.tolist(),
            "ratio_stderr": one.ratio_stderr.values.tolist(),
            "ratio_at_rest": {
                "so2": scene_so2,
                "value": float(one.ratio_at_rest),
                "stderr": float(one.ratio_at_rest_stderr),
            },
            "fit": {"intercept": terms[0], "slope": terms[1], "intercept_stderr": errors[0], "slope_stderr": errors[1]}
            | {"miss": float(one.linear_miss), "quadratic": one.quadratic.values.tolist()},
            "perfusion_index": dict(zip(leds, one.perfusion_index.values.tolist(), strict=True)),
            "perfusion_index_stderr": dict(zip(leds, one.perfusion_index_stderr.values.tolist(), strict=True)),
            "path_ratio": float(one.path_ratio),
            "path_ratio_stderr": float(one.path_ratio_stderr),
            "spo2_stderr": float(one.spo2_stderr),
            "spo2_stderr_beat": float(one.spo2_stderr_beat),
            "spo2_stderr_by_cause": dict(
                zip(map(str, one.cause.values), one.spo2_stderr_by_cause.values.tolist(), strict=True)
            ),
            "saturated": bool(one.saturated),
            "melanin_bound": float(one.melanin_bound),
            "disturbances": {
                key: {
                    "values": one[key].values.tolist(),
                    "spo2_off": one[f"off_by_{key}"].values.tolist(),
                    "stderr": one[f"off_by_{key}_stderr"].values.tolist(),
                }
                for key in result.attrs["disturbances"]
            },
        }
    kept = ("best", "warnings", "photons", "engine", "backend", "cpu_seconds", "wall_seconds", "digest")
    return {"readings": readings} | {name: result.attrs[name] for name in kept}


def recording_summary(result: "xr.Dataset") -> dict[str, Any]:
    """Medians over the windows without motion of an oximeter's recording, SpO2 in percent."""
    readings = {}
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        there = np.isfinite(one.spo2.values)
        row = {"windows": int(one.sizes["time"]), "still": int(there.sum()), "motion": float(one.motion.mean())}
        for key in ("ratio", "ratio_stderr", "spo2", "spo2_stderr", "spo2_low", "spo2_high", "rate_per_min"):
            values = one[key].values[np.isfinite(one[key].values)]
            row[key] = float(np.median(values)) if len(values) else None  # type: ignore[assignment]
        index = {k: one[f"perfusion_index_{k}"].values[there] for k in ("red", "infrared")}
        readings[str(name)] = row | {
            "perfusion_index": {k: float(np.nanmedian(v)) if len(v) else None for k, v in index.items()}
        }
    best = result.attrs["best"]
    return {
        "readings": readings,
        "best": best,
        **{k: readings[best][k] for k in ("spo2", "spo2_low", "spo2_high", "rate_per_min")},
    }


def calibration_summary(result: "xr.Dataset") -> dict[str, Any]:
    """Readings, factors, fit and warnings of a calibration."""
    from ..studies.force.subject import parse_subject

    subject = parse_subject(result.attrs["subject"])
    bent = set(result.attrs["bent_factors"])
    return {
        "readings": subject.readings(),
        "parameters": {name: one | {"quadratic": name not in bent} for name, one in subject.factors().items()},
        "chi2_per_dof": subject.chi2_per_dof,
        "rms_n": subject.rms_n,
        "half_width_n": result.attrs["half_width_n"],
        "widening": subject.coverage_factor,
        "warnings": list(result.attrs["warnings"]),
    }


def prediction_summary(result: "xr.Dataset") -> dict[str, Any]:
    """Errors, coverage, consistency and events of a prediction."""
    names = ["rms_n", "coverage_95", "chi2_per_dof", "open_above_n", "outliers", "misfit"]
    names += ["touch_rms_n", "touch_coverage_95", "half_width_n", "touch_open_above"]
    return {name: result.attrs[name] for name in names} | {
        "open_above_by_side_n": {side: float(result.attrs[f"open_above_{side}_n"]) for side in ("proximal", "distal")},
        "consistent": bool(result.attrs["consistent"]),
        "warnings": list(result.attrs["warnings"]),
        "baseline_rms_n": {name: result.attrs[f"rms_{name}_n"] for name in ("linear", "components")},
        "events": [
            {"time_s": float(time), "kind": str(kind), "latency_s": float(latency)}
            for time, kind, latency in zip(
                result.event_time_s.values, result.event_kind.values, result.event_latency_s.values, strict=True
            )
        ],
    }
