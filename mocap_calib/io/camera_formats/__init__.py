"""Camera files of other programs, a module for each family; `formats_cameras` is the table of them."""
