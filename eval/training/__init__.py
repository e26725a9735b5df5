"""Training: plan, images, steps, checkpoints."""
