//! Pictures as glTF holds them.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};

use crate::gltf::export::model::is_picture;

/// Pixels a side of the largest picture that is written anew.
const LARGEST: u32 = 16384;

/// Bytes of memory that one picture may take as pixels: 8,192 times 8,192 of four bytes.
const MEMORY: u64 = 256 << 20;

/// A picture's file as glTF without extensions can hold it: itself where it is PNG or JPEG, as PNG where it is BMP, TGA, TIFF,
/// WebP or a DDS of DXT, with the same values. `None` of others and of broken ones.
///
/// `name` tells a TGA, whose bytes do not.
pub(crate) fn for_gltf(name: &str, bytes: Vec<u8>) -> Option<Vec<u8>> {
    if is_picture(&bytes) {
        return Some(bytes);
    }
    let ending = name.trim().trim_matches('"').rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase());
    let of_name = || (ending.as_deref() == Some("tga")).then_some(ImageFormat::Tga);
    let format = image::guess_format(&bytes).ok().or_else(of_name)?;
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(LARGEST), Some(LARGEST));
    limits.max_alloc = Some(MEMORY);
    reader.limits(limits);
    let pixels = match reader.decode().ok()? {
        // PNG has no numbers with a point.
        DynamicImage::ImageRgb32F(pixels) => DynamicImage::ImageRgb32F(pixels).into_rgb16().into(),
        DynamicImage::ImageRgba32F(pixels) => DynamicImage::ImageRgba32F(pixels).into_rgba16().into(),
        pixels => pixels,
    };
    let mut png = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive);
    pixels.write_with_encoder(encoder).ok()?;
    Some(png)
}

#[cfg(test)]
mod tests {
    use image::RgbaImage;

    use super::*;

    fn pixels() -> RgbaImage {
        RgbaImage::from_fn(5, 3, |x, y| image::Rgba([x as u8 * 50, y as u8 * 100, 7, 255 - x as u8]))
    }

    fn written(format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        DynamicImage::ImageRgba8(pixels()).write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn other_formats_become_png_of_the_same_pixels() {
        for (name, format) in [
            ("a.bmp", ImageFormat::Bmp),
            ("a.TGA", ImageFormat::Tga),
            ("\"a b.tga\"", ImageFormat::Tga),
            ("a.tif", ImageFormat::Tiff),
            ("a.webp", ImageFormat::WebP),
            // By its bytes, whatever it is called.
            ("a", ImageFormat::Bmp),
        ] {
            let png = for_gltf(name, written(format)).unwrap_or_else(|| panic!("{name}"));
            assert!(png.starts_with(b"\x89PNG"), "{name}");
            assert_eq!(image::load_from_memory(&png).unwrap().into_rgba8(), pixels(), "{name}");
        }
        let png = written(ImageFormat::Png);
        assert_eq!(for_gltf("a.tga", png.clone()), Some(png));
    }

    #[test]
    fn what_is_no_picture_is_none() {
        // Without its name a TGA is not told from anything.
        assert_eq!(for_gltf("a.dat", written(ImageFormat::Tga)), None);
        let broken = written(ImageFormat::Bmp)[..60].to_vec();
        for (name, bytes) in [("a.tga", vec![]), ("a.tga", vec![0; 18]), ("a.bmp", broken), ("a.psd", b"8BPS".to_vec())]
        {
            assert_eq!(for_gltf(name, bytes), None, "{name}");
        }
        // A header that asks for four gigabytes.
        let mut huge = written(ImageFormat::Tga);
        huge[12..16].fill(0xff);
        assert_eq!(for_gltf("a.tga", huge), None);
    }

    #[test]
    fn a_file_cut_anywhere_makes_no_panic() {
        for format in [ImageFormat::Bmp, ImageFormat::Tga, ImageFormat::Tiff, ImageFormat::WebP] {
            let whole = written(format);
            for length in 0..whole.len() {
                for_gltf("a.tga", whole[..length].to_vec());
            }
        }
    }
}
