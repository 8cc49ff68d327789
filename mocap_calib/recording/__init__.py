"""Views on one clock: joining files, vocabularies of joints, and the frames that are looked at."""
