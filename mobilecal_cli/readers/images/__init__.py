"""Images: pixels of any encoding as 8-bit gray."""
