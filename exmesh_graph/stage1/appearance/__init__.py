"""What gives the surface its colour in Stage I: one model each, behind one interface (`model.AppearanceModel`)."""
