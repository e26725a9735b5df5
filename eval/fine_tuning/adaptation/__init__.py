"""Fine-tuning of the depth network on labelled recordings of one's own camera and rooms."""
