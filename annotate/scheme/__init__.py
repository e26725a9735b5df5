"""Parts of the body: the atlas of regions, and schemes whose parts are unions of regions."""
