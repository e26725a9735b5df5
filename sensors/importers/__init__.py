"""Other people's recordings and clouds as sources of frames."""
