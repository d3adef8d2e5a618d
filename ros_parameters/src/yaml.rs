//! Parser of untrusted YAML: the tree is never larger than the text. A YAML alias (`*name`) repeats
//! what its anchor (`&name`) holds, so that a file of a few kilobytes can expand to gigabytes. rcl
//! rejects aliases; here they are accepted as long as the tree is not larger than a text without
//! them could produce.

use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_yaml_ng::{Mapping, Value, value::Tag, value::TaggedValue};
use std::{cell::Cell, fmt};

/// Limit of opening brackets: the scanner's time per bracket grows with the nesting depth, so that
/// a megabyte of them would need hours.
const MOST_BRACKETS: usize = 10_000;

/// Parses a YAML text.
///
/// # Errors
/// Text that is not YAML, nests deeper than 128 levels, has more than 10 000 opening brackets, or
/// holds a key twice; aliases that expand beyond the text's length.
pub fn parse(text: &str) -> Result<Value, serde_yaml_ng::Error> {
    if text.bytes().filter(|b| matches!(b, b'[' | b'{')).count() > MOST_BRACKETS {
        return Err(Error::custom(
            "it has more than 10000 opening brackets; write its lists line by line",
        ));
    }
    // Without aliases each node and each byte of a string has a byte of the text.
    let budget = Cell::new(2 * text.len() + 64);
    Limited(&budget).deserialize(serde_yaml_ng::Deserializer::from_str(text))
}

/// Remaining budget of the tree: one per node, and one per byte of its text.
#[derive(Clone, Copy)]
struct Limited<'a>(&'a Cell<usize>);

impl Limited<'_> {
    fn spend<E: Error>(self, cost: usize) -> Result<(), E> {
        match self.0.get().checked_sub(cost) {
            Some(left) => {
                self.0.set(left);
                Ok(())
            }
            None => Err(E::custom(
                "its aliases (*name) expand to much more than its text; write the values out",
            )),
        }
    }
}

impl<'de> DeserializeSeed<'de> for Limited<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Limited<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a YAML value")
    }

    fn visit_unit<E: Error>(self) -> Result<Value, E> {
        self.spend(1)?;
        Ok(Value::Null)
    }

    fn visit_none<E: Error>(self) -> Result<Value, E> {
        self.visit_unit()
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<Value, E> {
        self.spend(1)?;
        Ok(Value::Bool(value))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Value, E> {
        self.spend(1)?;
        Ok(Value::Number(value.into()))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Value, E> {
        self.spend(1)?;
        Ok(Value::Number(value.into()))
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Value, E> {
        self.spend(1)?;
        Ok(Value::Number(value.into()))
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<Value, E> {
        self.spend(1 + value.len())?;
        Ok(Value::String(value.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        self.spend(1)?;
        let mut list = Vec::new();
        while let Some(item) = items.next_element_seed(self)? {
            list.push(item);
        }
        Ok(Value::Sequence(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        self.spend(1)?;
        let mut mapping = Mapping::new();
        while let Some(key) = entries.next_key_seed(self)? {
            if mapping.contains_key(&key) {
                let key = key.as_str().map_or_else(|| format!("{key:?}"), str::to_owned);
                return Err(A::Error::custom(format!("the key `{key}` occurs twice")));
            }
            let value = entries.next_value_seed(self)?;
            mapping.insert(key, value);
        }
        Ok(Value::Mapping(mapping))
    }

    fn visit_enum<A: serde::de::EnumAccess<'de>>(self, tagged: A) -> Result<Value, A::Error> {
        use serde::de::VariantAccess;
        let (tag, content) = tagged.variant::<String>()?;
        self.spend(1 + tag.len())?;
        let value = content.newtype_variant_seed(self)?;
        Ok(Value::Tagged(Box::new(TaggedValue { tag: Tag::new(tag), value })))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ordinary_text_parses_as_with_the_crate() {
        for text in [
            "",
            "a: 1\nb: [1, -2, 3.5, .inf, ~, true, 'x', 18446744073709551615]\nc: {d: {e: |\n  \
             text\n  more\n}}",
            "- &a {x: 1}\n- *a\n",
            "!tag {a: 1}",
            "? [1, 2]\n: complex",
            "1: one\ntrue: two\n",
        ] {
            let expected: Result<Value, _> = serde_yaml_ng::from_str(text);
            match (parse(text), expected) {
                (Ok(own), Ok(expected)) => assert_eq!(own, expected, "{text}"),
                (Err(_), Err(_)) => {}
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    #[test]
    fn expanding_aliases_are_rejected_at_once() {
        // Flat: ten thousand times ten thousand numbers.
        let flat = format!("a: &a [{}]\nb: [{}]\n", "1,".repeat(10_000), "*a,".repeat(10_000));
        // Nested: 9^9 strings.
        let mut nested = String::from("a0: &a0 [lol,lol,lol]\n");
        for level in 1..10 {
            let before = format!("*a{},", level - 1).repeat(9);
            nested += &format!("a{level}: &a{level} [{before}]\n");
        }
        let text = format!("a: &a \"{}\"\nb: [{}]\n", "x".repeat(10_000), "*a,".repeat(1_000));
        for text in [flat, nested, text] {
            let error = parse(&text).unwrap_err().to_string();
            assert!(error.contains("aliases"), "{error}");
        }
    }

    #[test]
    fn a_duplicate_key_is_an_error() {
        assert!(parse("a: 1\nb: 2\na: 3\n").unwrap_err().to_string().contains("`a`"));
    }

    #[test]
    fn unbounded_nesting_is_an_error() {
        // The first two would need hours.
        for (open, count) in
            [("[", 1 << 20), ("{a: ", 1 << 18), ("{a: ", 2_000), ("- ", 20_000), ("? ", 20_000)]
        {
            assert!(parse(&open.repeat(count)).is_err(), "{open}");
        }
    }
}
