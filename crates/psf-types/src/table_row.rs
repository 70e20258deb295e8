//! Rows of tables, whose columns are the fields of a struct.

/// Declares a struct for the rows of a table, and a constant with the names of the table's columns:
/// the names of the struct's fields.
#[doc(hidden)]
#[macro_export]
macro_rules! table_row {
    ($(#[$meta:meta])* $columns:ident $row:ident { $($(#[$of_field:meta])* $field:ident: $type:ty,)+ }) => {
        #[doc = concat!("The names of the columns of a table of [`", stringify!($row), "`]s.")]
        pub const $columns: &[&str] = &[$(stringify!($field)),+];

        $(#[$meta])*
        pub struct $row {
            $($(#[$of_field])* pub $field: $type,)+
        }
    };
}
