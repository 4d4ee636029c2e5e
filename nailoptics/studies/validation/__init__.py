"""The model beside what was measured on people."""
