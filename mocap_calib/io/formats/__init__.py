"""The formats of files: a module a program, its records of formats at its end."""
