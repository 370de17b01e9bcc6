"""The paper's tables, slopes and figures, compared with the printed values."""
