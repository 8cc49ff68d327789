"""Where coordinates begin, what is up, and how long a metre is: the world of cameras and poses."""
