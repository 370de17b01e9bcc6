"""Raw lenslet images: where the lenslets are, and decoding into views."""
