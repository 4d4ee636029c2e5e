"""Python loads this as it starts where this folder is on its path."""

import fewer_photons

fewer_photons.install()
