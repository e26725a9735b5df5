"""People in colour images by 2-D pose networks, and labels of depth images by their testimony."""
