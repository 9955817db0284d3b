"""The experiments; their TOML files are packaged with jaxreplay."""
