"""Shipped facts: each with its citation, read from both kinds of install."""

import shutil

import numpy as np
import pytest

from nailoptics import assets
from nailoptics.assets import asset_path, data_dir, read_table
from nailoptics.errors import InputError

SPECTRA = sorted(path.name for path in (data_dir("assets") / "spectra").glob("*.csv"))


@pytest.mark.parametrize("name", SPECTRA)
def test_a_spectrum_covers_400_to_1000_nm_and_cites_its_source(name):
    header = [line for line in asset_path(f"spectra/{name}").read_text().splitlines() if line.startswith("#")]
    assert "Source:" in "".join(header) or "FITTED" in header[0]
    assert any(char.isdigit() for char in "".join(header))
    wavelength_nm = read_table(f"spectra/{name}")["wavelength_nm"]
    assert wavelength_nm[0] <= 400 and wavelength_nm[-1] >= 1000 and (np.diff(wavelength_nm) > 0).all()
    assert all(np.isfinite(column).all() for column in read_table(f"spectra/{name}").values())


def test_spectra_cannot_be_changed_by_a_caller():
    with pytest.raises(ValueError, match="read-only"):
        read_table("spectra/water.csv")["mu_a_per_mm"][0] = 1.0


def test_a_wheels_own_folder_comes_first(tmp_path, monkeypatch):
    package = tmp_path / "nailoptics"
    (package / "_assets").mkdir(parents=True)
    (tmp_path / "assets").mkdir()
    monkeypatch.setattr(assets, "_PACKAGE", package)
    assert data_dir("assets") == package / "_assets"
    shutil.rmtree(package / "_assets")
    assert data_dir("assets") == tmp_path / "assets"
    with pytest.raises(InputError, match="scenes is missing"):
        data_dir("scenes")


def test_an_asset_that_is_not_there_is_named():
    with pytest.raises(InputError, match='"spectra/air.csv" does not exist'):
        asset_path("spectra/air.csv")
