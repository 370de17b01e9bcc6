"""The paper's reproduction and the project's studies; they use the library from outside."""
