//! A bounded sequence in a fixed place, for the parts of a message of which only some rows count.

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::marker::PhantomData;

/// Up to `MAX` items, read without allocating. Unused places are zero.
pub(super) struct Bounded<T, const MAX: usize> {
    pub(super) items: [T; MAX],
    pub(super) len: usize,
}

impl<'de, T: Deserialize<'de> + bytemuck::Zeroable + Copy, const MAX: usize> Deserialize<'de>
    for Bounded<T, MAX>
{
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Rows(PhantomData))
    }
}

struct Rows<T, const MAX: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de> + bytemuck::Zeroable + Copy, const MAX: usize> Visitor<'de>
    for Rows<T, MAX>
{
    type Value = Bounded<T, MAX>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at most {MAX} rows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut rows: A) -> Result<Self::Value, A::Error> {
        let mut read = Bounded { items: [T::zeroed(); MAX], len: 0 };
        while let Some(row) = rows.next_element()? {
            let place = read
                .items
                .get_mut(read.len)
                .ok_or_else(|| A::Error::invalid_length(MAX + 1, &self))?;
            *place = row;
            read.len += 1;
        }
        Ok(read)
    }
}
