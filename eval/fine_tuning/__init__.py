"""Fine-tuning of a segmentation network on the corrected frames of one person and room."""
