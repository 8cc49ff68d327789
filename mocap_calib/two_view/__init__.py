"""The relative pose of two views, and who is who in them."""
