"""Files read and written safely: bounded, atomic, TOML, PNG."""
