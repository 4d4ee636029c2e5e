"""The photon walks: finger and phantom, what they meet, and what they tally; each imports Mitsuba."""
