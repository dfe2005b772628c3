//! Images as bytes.
