"""Where the paper's reduced optics hold against traced light."""
