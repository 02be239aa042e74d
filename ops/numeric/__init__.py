"""Recognition of motions by numbers: channels of frames, descriptors of spans, and models of classes."""
