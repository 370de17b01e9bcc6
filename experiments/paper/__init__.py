"""The paper's tables, slopes and figures, beside the printed values."""
