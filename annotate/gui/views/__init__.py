"""The cloud in 3D and the depth image in 2D, with the mouse over them."""
