"""Labels on disk: the folder, its images, its journal, its one writer."""
