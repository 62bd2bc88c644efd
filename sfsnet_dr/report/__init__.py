"""Records of measured numbers, and the plots and pages that read them."""
