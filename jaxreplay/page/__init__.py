"""What a browser shows: one run as one HTML file, without anything from outside."""
