"""Videos of light fields: steps for each frame, by many processes, into one Zarr group."""
