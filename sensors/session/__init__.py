"""Sessions (recordings of frames in one MCAP file): writing, indexing, reading."""
