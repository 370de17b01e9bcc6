"""The paper's network: backbone, decoder, training, and trained networks in files."""
