//! Types of protobuf messages, and their descriptors.

use std::collections::BTreeSet;

use crate::protobuf::Message;

/// Type of a field, with its number in descriptors.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Kind {
    Double,
    Int64,
    Int32,
    Fixed32,
    Bool,
    Text,
    Bytes,
    Of(&'static MessageType),
    /// Names of the values from 0 on. The type is declared within the message.
    Choice(&'static str, &'static [&'static str]),
}

/// How often a field occurs.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Times {
    One,
    /// Its absence differs from zero.
    Optional,
    Many,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Field {
    number: u32,
    name: &'static str,
    kind: Kind,
    times: Times,
}

pub(crate) const fn one(number: u32, name: &'static str, kind: Kind) -> Field {
    Field { number, name, kind, times: Times::One }
}

pub(crate) const fn many(number: u32, name: &'static str, kind: Kind) -> Field {
    Field { number, name, kind, times: Times::Many }
}

pub(crate) const fn optional(number: u32, name: &'static str) -> Field {
    Field { number, name, kind: Kind::Double, times: Times::Optional }
}

/// Message type, one per file as in Foxglove's repository.
#[derive(Debug)]
pub(crate) struct MessageType {
    pub package: &'static str,
    pub name: &'static str,
    pub fields: &'static [Field],
}

impl MessageType {
    /// Returns the name with its package.
    pub fn full_name(&self) -> String {
        format!("{}.{}", self.package, self.name)
    }

    /// Returns a FileDescriptorSet of this type and all types in it.
    pub fn descriptor_set(&'static self) -> Vec<u8> {
        let mut set = Message::default();
        for of in self.with_parts() {
            set = set.message(1, &of.file_descriptor());
        }
        set.into_bytes()
    }

    /// Returns the types of which this one consists, each after its own parts, and last itself.
    fn with_parts(&'static self) -> Vec<&'static Self> {
        let mut types: Vec<&Self> = Vec::new();
        for of in self.parts().flat_map(Self::with_parts).chain([self]) {
            if !types.iter().any(|known| std::ptr::eq(*known, of)) {
                types.push(of);
            }
        }
        types
    }

    fn parts(&self) -> impl Iterator<Item = &'static Self> {
        self.fields.iter().filter_map(|field| match field.kind {
            Kind::Of(of) => Some(of),
            _ => None,
        })
    }

    /// Returns the name of the file that declares it.
    fn file(&self) -> String {
        // Google's have small letters.
        let name = if self.package == "google.protobuf" { self.name.to_lowercase() } else { self.name.to_owned() };
        format!("{}/{name}.proto", self.package.replace('.', "/"))
    }

    fn file_descriptor(&self) -> Message {
        let mut file = Message::default().text(1, &self.file()).text(2, self.package);
        for import in self.parts().map(Self::file).collect::<BTreeSet<_>>() {
            file = file.text(3, &import);
        }
        let mut of = Message::default().text(1, self.name);
        let mut choices = 0;
        for field in self.fields {
            of = of.message(2, &field.descriptor(&self.full_name(), choices));
            choices += u64::from(field.times == Times::Optional);
        }
        for field in self.fields {
            if let Kind::Choice(name, values) = field.kind {
                let value = |(number, name): (u64, &&str)| Message::default().text(1, name).varint(2, number);
                let choice = (0..).zip(values).map(value);
                of = of.message(4, &choice.fold(Message::default().text(1, name), |list, one| list.message(2, &one)));
            }
        }
        // The presence of an optional field is declared as a choice of one.
        for field in self.fields.iter().filter(|field| field.times == Times::Optional) {
            of = of.message(8, &Message::default().text(1, &format!("_{}", field.name)));
        }
        file.message(4, &of).text(12, "proto3")
    }
}

impl Field {
    fn descriptor(&self, parent: &str, choice: u64) -> Message {
        let label = if self.times == Times::Many { 3 } else { 1 };
        let number = match self.kind {
            Kind::Double => 1,
            Kind::Int64 => 3,
            Kind::Int32 => 5,
            Kind::Fixed32 => 7,
            Kind::Bool => 8,
            Kind::Text => 9,
            Kind::Of(_) => 11,
            Kind::Bytes => 12,
            Kind::Choice(..) => 14,
        };
        let mut field = Message::default().text(1, self.name).varint(3, u64::from(self.number));
        field = field.varint(4, label).varint(5, number);
        match self.kind {
            Kind::Of(of) => field = field.text(6, &format!(".{}", of.full_name())),
            Kind::Choice(name, _) => field = field.text(6, &format!(".{parent}.{name}")),
            _ => (),
        }
        if self.times == Times::Optional { field.varint(9, choice).varint(17, 1) } else { field }
    }
}
