!> Exponents close to each other, computed together.
!!
!! Memory that hardly couples gives each spring an exponent of nearly the same size. Near m zeros
!! Hill's determinant D is so small that rounding moves each by the m-th root of its own size,
!! while their mean stays sharp. On a circle about them, lambda = c + r z, |z| = 1,
!!
!!   log(D/z^m) = a_0 + sum_k a_k z^k + sum_k b_k z^(-k),  b_k = -s_k/k,
!!   s_k = sum_i ((lambda_i - c)/r)^k
!!
!! if the circle holds m zeros and nothing else (it turns D by 2 pi m). Zeros that are given are
!! divided out in place of z^m, and the b_k say by how much their sums are wrong. Newton's
!! identities give the polynomial of the zeros from the sums. With its zeros divided out the b_k
!! are rounding errors. Given zeros with these sums are kept. Otherwise the zeros of the polynomial
!! are used. If their distances do not exceed the m-th root of the rounding error, each is replaced
!! by their mean. Zeros that were close to each other at a neighbouring solution are found in this
!! way from the start, without a search.
!! (Kravanja and Van Barel, Computing the Zeros of Analytic Functions, Springer 2000.)
module viscovib_hill_clusters
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polar, only: plain_logarithm
  use viscovib_polynomial_zeros, only: polynomial_zeros
  use viscovib_sorting, only: sort_falling
  implicit none
  private

  public :: clusters_near, sharpen_clusters

  !> Exponents nearer than this, in d, are close to each other.
  real(wp), parameter :: near = 1.0e-4_wp
  !> Values on a circle, those above the line of symmetry, and fewer, which find as many zeros at
  !! most; zeros at most that the turns of the many show.
  integer, parameter :: many = 12, few = 6, most_of_few = 3, most = 6
  !> Circles tried, each twice as wide, from this many times the distance of the outermost zero, and
  !! the least radius in d: within it rounding errors exceed D.
  integer, parameter :: n_circles = 6
  real(wp), parameter :: wider = 8.0_wp, least = 2.0e-5_wp
  !> The same of zeros that are found at once: those that rounding moves are not found so.
  real(wp), parameter :: least_at_once = 5.0e-6_wp
  !> Numbers are distinct beyond this multiple of their rounding error, and beyond this in d; and
  !! the rounding of b_k with which zeros are found at once.
  real(wp), parameter :: sure = 8.0_wp, fine = 1.0e-12_wp, clear = 1.0e-8_wp

contains

  !> Exponents close to each other, near those of a neighbouring solution.
  subroutine clusters_near(hill, system, nearby, used, found, n)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> Exponents nearby, NaN for none.
    complex(wp), intent(in) :: nearby(:)
    !> Those of a cluster that was found; its exponents and how many they are.
    logical, intent(out) :: used(:)
    complex(wp), intent(inout) :: found(:)
    integer, intent(out) :: n
    complex(wp) :: starts(size(nearby))
    complex(wp), allocatable :: zeros(:)
    logical :: taken(size(nearby)), group(size(nearby))
    integer :: i, m
    logical :: made

    n = 0
    used = .false.
    starts = nearby
    taken = ieee_is_nan(real(nearby))
    call raise(hill, starts, taken)
    do i = 1, size(nearby)
      if (taken(i)) cycle
      call group_of(hill, starts, taken, i, group)
      taken = taken .or. group
      m = count(group)
      if (m < 2 .or. m > most .or. n + m >= size(found)) cycle
      zeros = pack(starts, group)
      call find_together(hill, system, zeros, made)
      if (.not. made) cycle
      used = used .or. group
      found(n + 1:n + m) = zeros
      n = n + m
    end do
    call lower(hill, found(:n))
  end subroutine clusters_near

  !> Each group of exponents on the line of symmetry, or about it, that lie side by side, made
  !! sharp. Others, and groups that no circle holds alone, are left as they are.
  subroutine sharpen_clusters(hill, system, sharp, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> Those that are sharp.
    complex(wp), intent(in) :: sharp(:)
    !> Largest real part first, NaN behind the last; again so on exit.
    complex(wp), intent(inout) :: exponents(:)
    complex(wp), allocatable :: zeros(:)
    logical :: taken(size(exponents)), group(size(exponents)), done(size(exponents))
    integer :: i, m, n

    taken = ieee_is_nan(real(exponents))
    n = count(.not. taken)
    done = .false.
    do i = 1, n
      done(i) = any(abs(sharp - exponents(i)) <= 0.0_wp)
    end do
    call raise(hill, exponents, taken)
    do i = 1, n
      if (taken(i)) cycle
      call group_of(hill, exponents, taken, i, group)
      taken = taken .or. group
      m = count(group)
      if (m < 2 .or. m > most .or. .not. any(group .and. .not. done)) cycle
      zeros = pack(exponents, group)
      call sharpen(hill, system, zeros)
      exponents = unpack(zeros, group, exponents)
    end do
    call lower(hill, exponents(:n))
    call sort_falling(exponents(:n), real(exponents(:n)))
  end subroutine sharpen_clusters

  !> Both of a pair about the line Im lambda = d/2 on that line's two sides.
  pure subroutine raise(hill, exponents, left_out)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(inout) :: exponents(:)
    logical, intent(in) :: left_out(:)
    integer :: i

    do i = 1, size(exponents)
      if (left_out(i)) cycle
      if (aimag(exponents(i)) < -0.25_wp*hill%period) then
        exponents(i) = exponents(i) + cmplx(0.0_wp, hill%period, wp)
      end if
    end do
  end subroutine raise

  !> All within the strip.
  pure subroutine lower(hill, exponents)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(inout) :: exponents(:)
    where (aimag(exponents) > 0.5_wp*hill%period)
      exponents = exponents - cmplx(0.0_wp, hill%period, wp)
    end where
  end subroutine lower

  !> The exponents close to exponent i, including itself.
  pure subroutine group_of(hill, exponents, taken, i, group)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: exponents(:)
    logical, intent(in) :: taken(:)
    integer, intent(in) :: i
    logical, intent(out) :: group(:)
    integer :: grown

    group = .false.
    group(i) = .true.
    do
      grown = count(group)
      call spread_out(exponents, taken, near*hill%period, group)
      if (count(group) == grown) exit
    end do
  end subroutine group_of

  !> A group contains zeros that are near one of its members.
  pure subroutine spread_out(exponents, taken, distance, group)
    complex(wp), intent(in) :: exponents(:)
    logical, intent(in) :: taken(:)
    real(wp), intent(in) :: distance
    logical, intent(inout) :: group(:)
    integer :: i, k

    do k = 1, size(exponents)
      if (taken(k)) cycle
      do i = 1, size(exponents)
        ! What is no number is in no group.
        if (.not. group(i)) cycle
        if (abs(exponents(i) - exponents(k)) < distance) group(k) = .true.
      end do
    end do
  end subroutine spread_out

  !> The line of symmetry about which zeros lie; its place among them, and the least circle.
  pure subroutine place_circle(hill, zeros, smallest, line, centre, radius, about)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: zeros(:)
    !> The least radius, in d.
    real(wp), intent(in) :: smallest
    real(wp), intent(out) :: line, centre, radius
    !> With the conjugate of each, and on one side of the axis: only then D is real along the line,
    !! and what lies on both sides of the axis stays as it was counted.
    logical, intent(out) :: about

    line = merge(0.5_wp, 0.0_wp, any(abs(aimag(zeros)) > 0.25_wp*hill%period))*hill%period
    centre = sum(real(zeros))/size(zeros)
    radius = max(smallest*hill%period, wider*maxval(abs(zeros - cmplx(centre, line, wp))))
    about = abs(sum(aimag(zeros))/size(zeros) - line) <= 1.0e-9_wp*hill%period &
            .and. abs(centre) > radius
  end subroutine place_circle

  !> The zeros of one group at once, from where they were at a solution nearby.
  subroutine find_together(hill, system, zeros, made)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(inout) :: zeros(:)
    logical, intent(out) :: made
    real(wp) :: centre, radius, line, lost
    logical :: confirmed

    call place_circle(hill, zeros, least_at_once, line, centre, radius, made)
    if (.not. made) return
    call on_circle(hill, system, cmplx(centre, line, wp), radius, line > 0.0_wp, &
                   merge(few, many, size(zeros) <= most_of_few), zeros, lost, made, confirmed)
    ! From one start for all they would not be found again.
    made = made .and. lost <= clear*radius .and. maxval(abs(zeros - zeros(1))) > 0.0_wp
  end subroutine find_together

  !> The zeros of one group.
  subroutine sharpen(hill, system, zeros)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(inout) :: zeros(:)
    complex(wp) :: found(size(zeros)), better(size(zeros))
    real(wp) :: centre, radius, line, lost, smallest
    integer :: i
    logical :: made, confirmed

    call place_circle(hill, zeros, least, line, centre, radius, made)
    if (.not. made) return
    smallest = huge(smallest)
    better = zeros
    do i = 1, n_circles
      if (abs(centre) <= radius) exit
      found = zeros
      call on_circle(hill, system, cmplx(centre, line, wp), radius, line > 0.0_wp, many, found, &
                     lost, made, confirmed)
      if (.not. made) exit
      if (confirmed) return
      if (lost < smallest) then
        smallest = lost
        better = found
      end if
      radius = 2.0_wp*radius
    end do
    zeros = better
  end subroutine sharpen

  !> The zeros in a circle from what was found of them, and how far their mean may be off; not made
  !! where they are not alone.
  subroutine on_circle(hill, system, centre, radius, upper, half, zeros, lost, made, confirmed)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: centre
    real(wp), intent(in) :: radius
    logical, intent(in) :: upper
    !> Values above the line of symmetry.
    integer, intent(in) :: half
    complex(wp), intent(inout) :: zeros(:)
    real(wp), intent(out) :: lost
    logical, intent(out) :: made
    !> Whether they are right as they were found.
    logical, intent(out) :: confirmed
    complex(wp) :: z(half), value(half), given(size(zeros))
    real(wp) :: b(half - 1), wrong(half - 1), sums(size(zeros)), floor, rough, reach
    integer :: j, k, m

    m = size(zeros)
    made = .false.
    confirmed = .false.
    lost = huge(lost)
    do j = 1, half
      z(j) = exp(cmplx(0.0_wp, pi*(j - 0.5_wp)/half, wp))
      call hill%determinant(system, centre + radius*z(j), value(j), about_half=upper)
      if (.not. (abs(value(j)) <= huge(1.0_wp) .and. abs(value(j)) > 0.0_wp)) return
    end do
    given = (zeros - centre)/radius
    reach = maxval(abs(given))
    call left_of_zeros(z, value, given, wrong, rough, made)
    if (.not. made) return
    sums = [(real(sum(given**k)) - k*wrong(k), k=1, m)]
    call from_sums(sums, given, made)
    if (made) made = maxval(abs(given)) < 0.5_wp
    if (made) call left_of_zeros(z, value, given, b, rough, made)
    floor = maxval(abs(b))
    if (half == many) floor = max(floor, rough)
    made = made .and. floor < 0.1_wp
    if (.not. made) return
    lost = floor*radius
    ! An error e of the zeros adds up to e |z|^(k - 1) to b_k.
    confirmed = all(abs(wrong(:m)) <= [(max(sure*floor, fine*hill%period/radius*reach**(k - 1)), &
                                        k=1, m)])
    if (confirmed) return
    if (maxval(abs(given - sums(1)/m)) < sure*floor**(1.0_wp/m)) given = sums(1)/m
    zeros = centre + radius*given
  end subroutine on_circle

  !> The b_k of values above the real axis with zeros divided out, those below being conjugates, and
  !! the largest a_k of high k.
  pure subroutine left_of_zeros(z, value, zeros, b, rough, made)
    complex(wp), intent(in) :: z(:), value(:), zeros(:)
    real(wp), intent(out) :: b(:), rough
    !> Whether nothing else in the circle turns the values.
    logical, intent(out) :: made
    complex(wp) :: left(size(z)), logarithm(size(z))
    integer :: j, k

    b = 0.0_wp
    rough = 0.0_wp
    left = value
    do k = 1, size(zeros)
      left = left/(z - zeros(k))
    end do
    ! From one end of the half circle to the other the argument of the quotient does not change.
    if (real(left(1)) < 0.0_wp) left = -left
    logarithm(1) = plain_logarithm(left(1))
    do j = 2, size(z)
      logarithm(j) = logarithm(j - 1) + plain_logarithm(left(j)/left(j - 1))
    end do
    made = abs(aimag(logarithm(size(z)))) <= 0.5_wp*pi
    if (.not. made) return
    do k = 1, size(b)
      b(k) = sum(real(logarithm*z**k))/size(z)
      if (3*k >= 2*size(z)) rough = max(rough, abs(sum(real(logarithm*conjg(z)**k)))/size(z))
    end do
  end subroutine left_of_zeros

  !> Zeros of a real polynomial from the sums of their powers.
  subroutine from_sums(sums, zeros, made)
    real(wp), intent(in) :: sums(:)
    complex(wp), intent(out) :: zeros(:)
    logical, intent(out) :: made
    real(wp) :: c(0:size(sums))
    integer :: k

    c(0) = 1.0_wp
    do k = 1, size(sums)
      c(k) = -dot_product(c(k - 1:0:-1), sums(:k))/k
    end do
    call polynomial_zeros(c, zeros, made)
  end subroutine from_sums

end module viscovib_hill_clusters
