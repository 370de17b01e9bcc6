"""What a camera looks at: layers with textures, flames, shapes, dead leaves; scene files."""
