"""Files of measurements as they lie on the disk: text, tables and headers, of whatever program wrote them."""
