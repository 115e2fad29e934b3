"""The HTTP side of the studio: who may ask, what is asked, how it is answered."""
