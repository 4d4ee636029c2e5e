"""Stock Mitsuba's volpath through real participating media: the engine that checks the photon walk."""
