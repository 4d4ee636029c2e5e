"""The page of place: ranking, maps, the best layouts and their verification."""
