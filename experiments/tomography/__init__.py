"""How well emission by depth is found, on phantoms that the inversion's operator did not make."""
