! Optimize: -O2 -fstack-arrays
!> Growth of modes at rest by terms that are not part of the modulation equations.
!!
!! A motion of frequencies f_i excites pairs of modes at rest if n.f is near the sum of their
!! frequencies. For |n| = 1 and 2 the products of the expansion include this. For |n| = 3 it is an
!! effect of the next order. Its coefficient is the residual (`viscovib_motion_defect`) of the
!! motion with a small amplitude of a mode at rest: modes j and k change by
!!
!!   a_k' = sum_m P_km a_m + Q_kj conj(a_j) exp(i D t), and the same with j and k exchanged,
!!
!! where D = n.f - W_j - W_k. P is that of the modulation equations plus the residual of the modes'
!! own exponents. In a frame that rotates at D/2 the equations are autonomous: growth follows from
!! one eigenproblem.
module viscovib_resting_modes
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_motion_defect, only: changes_type, find_changes
  use viscovib_motion_lattice, only: angles_type, find_angles, list_orders, max_angles
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_normal_orders, only: answer_triples
  use viscovib_normal_products, only: least_of_far, reach_type
  use viscovib_polynomial_form, only: full_system_type, polynomial_form_type
  use viscovib_resonant_terms, only: far_influence, first_size
  use viscovib_slow_flow, only: real_matrix
  use viscovib_status, only: status_type
  implicit none
  private

  public :: resting_growth, far_growth, resting_error

  !> Largest width of such an instability tongue, relative to a mode's frequency.
  real(wp), parameter :: reach = 0.3_wp
  !> Amplitude of a mode at rest, relative to the motion.
  real(wp), parameter :: little = 3.0e-4_wp
  integer, parameter :: order = 3
  !> Growth, relative to the largest frequency, up to which a motion counts as stable.
  real(wp), parameter :: neutral = 1.0e-9_wp
  !> Relative distance from a mode within which terms contribute to its rate of change.
  real(wp), parameter :: still = 1.0e-7_wp

  !> Modes at rest, and the coupling of pairs of them.
  type :: pairs_type
    !> The frequencies |n.f|, |n| = 3.
    real(wp), allocatable :: drives(:)
    !> Modes at rest, and those of them near an excitation, shape (n_modes).
    logical, allocatable :: rests(:), asked(:)
    !> Q and P, shape (n_modes, n_modes).
    complex(wp), allocatable :: coupling(:, :), by_a(:, :)
  end type pairs_type

contains

  !> The fastest growth of a pair of modes at rest; -huge if no excitation is near.
  subroutine resting_growth(scales, full, a, growth)
    type(multiple_scales_type), intent(inout) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    !> Amplitudes of a steady motion, in natural units.
    complex(wp), intent(in) :: a(:)
    real(wp), intent(out) :: growth
    type(angles_type) :: angles
    type(pairs_type) :: pairs
    real(wp) :: drive, nearest
    integer, allocatable :: orders(:, :)
    integer :: j, k

    growth = -huge(1.0_wp)
    pairs%rests = .not. abs(a) > 0.0_wp
    if (.not. any(pairs%rests)) return
    call find_angles(scales, a, angles)
    if (angles%n > max_angles - 1) return
    call list_orders(angles%n, order, orders)
    pairs%drives = pack(abs(matmul(angles%frequency(:angles%n), orders(:angles%n, :))), &
                        sum(abs(orders), 1) == order)
    call find_pairs(scales, pairs)
    if (.not. any(pairs%asked)) return
    call couple_pairs(scales, full, a, pairs)
    associate (frame => scales%flow%frame, asked => pairs%asked)
      do j = 1, size(a)
        do k = j, size(a)
          if (.not. (asked(j) .and. asked(k))) cycle
          call find_nearest(pairs%drives, frame(j) + frame(k), drive, nearest)
          if (nearest > reach*min(frame(j), frame(k))) cycle
          growth = max(growth, growth_of(pairs, j, k, drive - frame(j) - frame(k)))
        end do
      end do
    end associate
  end subroutine resting_growth

  !> Pairs of modes at rest near an excitation.
  subroutine find_pairs(scales, pairs)
    type(multiple_scales_type), intent(in) :: scales
    type(pairs_type), intent(inout) :: pairs
    real(wp) :: drive, nearest
    integer :: j, k
    allocate (pairs%asked(size(pairs%rests)), source=.false.)
    associate (frame => scales%flow%frame, rests => pairs%rests)
      do j = 1, size(rests)
        do k = 1, size(rests)
          if (.not. (rests(j) .and. rests(k))) cycle
          call find_nearest(pairs%drives, frame(j) + frame(k), drive, nearest)
          if (nearest <= reach*min(frame(j), frame(k))) pairs%asked([j, k]) = .true.
        end do
      end do
    end associate
  end subroutine find_pairs

  !> P and Q of the selected modes.
  subroutine couple_pairs(scales, full, a, pairs)
    type(multiple_scales_type), intent(inout) :: scales
    class(full_system_type), intent(in), optional :: full
    complex(wp), intent(in) :: a(:)
    type(pairs_type), intent(inout) :: pairs
    complex(wp) :: by_conjugate(size(a), size(a))
    type(changes_type), allocatable :: changes(:)
    type(status_type) :: status
    integer, allocatable :: which(:)
    integer :: j
    allocate (pairs%by_a(size(a), size(a)))
    allocate (pairs%coupling(size(a), size(a)), source=(0.0_wp, 0.0_wp))
    call scales%flow%slopes(a, pairs%by_a, by_conjugate)
    which = pack([(j, j=1, size(a))], pairs%asked)
    allocate (changes(size(which)))
    call answer_triples(scales%normal, scales%form, abs(a) > 0.0_wp, 1, status)
    if (status%failed()) return
    call find_changes(scales, full, a, which, little_of(scales, a), reach, changes)
    do j = 1, size(which)
      call add_change(scales, which(j), changes(j), pairs)
    end do
  end subroutine couple_pairs

  !> n.f, |n| = 3, nearest to a frequency.
  pure subroutine find_nearest(drives, wanted, drive, nearest)
    real(wp), intent(in) :: drives(:), wanted
    real(wp), intent(out) :: drive, nearest
    drive = 0.0_wp
    nearest = huge(1.0_wp)
    if (size(drives) == 0) return
    drive = drives(minloc(abs(drives - wanted), 1))
    nearest = abs(drive - wanted)
  end subroutine find_nearest

  !> Add the effect of mode j.
  subroutine add_change(scales, j, change, pairs)
    type(multiple_scales_type), intent(in) :: scales
    integer, intent(in) :: j
    type(changes_type), intent(in) :: change
    type(pairs_type), intent(inout) :: pairs
    integer :: i, k
    associate (frame => scales%flow%frame)
      do i = 1, size(change%frequency)
        associate (f => change%frequency(i), rates => change%rates(:, i))
          if (.not. change%by_conjugate(i)) then
            if (abs(f - frame(j)) > still*frame(j)) cycle
            pairs%by_a(j, j) = pairs%by_a(j, j) + rates(j)
            cycle
          end if
          do k = 1, size(frame)
            if (.not. pairs%asked(k)) cycle
            if (.not. is_drive(pairs%drives, f + frame(j), frame(j) + frame(k))) cycle
            pairs%coupling(k, j) = pairs%coupling(k, j) + rates(k)
          end do
        end associate
      end do
    end associate
  end subroutine add_change

  !> A small amplitude of a mode at rest, relative to the motion or, if no mode is active, to the
  !! response to loads alone. A small number of natural units may be much larger than both.
  pure real(wp) function little_of(scales, a)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: a(:)
    little_of = little*maxval(abs(a))
    if (.not. little_of > 0.0_wp) little_of = little*first_size(scales%normal, abs(a))
  end function little_of

  !> True if this is the nearest n.f to a frequency.
  pure logical function is_drive(drives, f, wanted)
    real(wp), intent(in) :: drives(:), f, wanted
    real(wp) :: drive, nearest
    call find_nearest(drives, wanted, drive, nearest)
    is_drive = nearest < huge(1.0_wp) .and. abs(f - drive) <= 1.0e-9_wp*wanted
  end function is_drive

  !> Largest real part for the modes at rest with j and k excited.
  real(wp) function growth_of(pairs, j, k, off)
    type(pairs_type), intent(in) :: pairs
    integer, intent(in) :: j, k
    real(wp), intent(in) :: off
    complex(wp), dimension(size(pairs%rests), size(pairs%rests)) :: driven, turned
    integer, allocatable :: which(:)
    integer :: i
    driven = (0.0_wp, 0.0_wp)
    driven(j, k) = pairs%coupling(j, k)
    driven(k, j) = pairs%coupling(k, j)
    turned = pairs%by_a
    do i = 1, size(turned, 1)
      turned(i, i) = turned(i, i) - cmplx(0.0_wp, 0.5_wp*off, wp)
    end do
    which = pack([(i, i=1, size(turned, 1))], pairs%rests)
    growth_of = fastest(turned(which, which), driven(which, which))
  end function growth_of

  !> The largest growth of da' = P da + Q conj(da); -huge if the eigenvalues do not converge.
  real(wp) function fastest(p, q)
    complex(wp), intent(in) :: p(:, :), q(:, :)
    complex(wp) :: values(2*size(p, 1))
    logical :: found
    call eigenvalues(real_matrix(p, q), values, found)
    fastest = -huge(1.0_wp)
    if (found) fastest = maxval(real(values))
  end function fastest

  !> Growth of the modes at rest by terms of the expansion that are too far from a mode for the
  !! modulation equations, but have an effect if motions are large: the growth by the equations
  !! that include them, about the same motion; -huge without such terms.
  subroutine far_growth(scales, full, form, tolerance, reach_of_modes, a, own, wide, growth, left)
    type(multiple_scales_type), intent(inout) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    !> In the caller's units.
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    type(reach_type), intent(in) :: reach_of_modes
    !> Amplitudes of a steady motion, in natural units.
    complex(wp), intent(in) :: a(:)
    !> The largest growth without these terms.
    real(wp), intent(in) :: own
    !> The expansion with these terms; its arrays are kept.
    type(multiple_scales_type), intent(inout) :: wide
    real(wp), intent(out) :: growth
    !> Largest influence of terms that are not constant in any frame.
    real(wp), intent(out) :: left
    type(status_type) :: status
    complex(wp), dimension(size(a), size(a)) :: by_a, by_conjugate
    integer, allocatable :: which(:)
    integer :: j

    growth = -huge(1.0_wp)
    left = 0.0_wp
    if (.not. scales%normal%framed) return
    left = far_influence(scales%normal, scales%form, abs(a))
    if (left < least_of_far) return
    call new_multiple_scales(wide, form, tolerance, .true., status, reach_of_modes, abs(a), .true.)
    if (status%failed() .or. .not. wide%flow%autonomous) return
    ! The motion is the same in both.
    if (any(abs(a) > 0.0_wp .and. abs(wide%flow%frame - scales%flow%frame) &
            > 1.0e-9_wp*scales%flow%frame)) return
    left = far_influence(wide%normal, wide%form, abs(a))
    which = pack([(j, j=1, size(a))], .not. abs(a) > 0.0_wp)
    call wide%flow%slopes(a, by_a, by_conjugate)
    growth = fastest(by_a(which, which), by_conjugate(which, which))
    ! The next order is needed only if this growth makes a stable motion unstable.
    associate (least => neutral*maxval(wide%flow%frame))
      if (own > least .or. growth <= least) return
    end associate
    call add_next_order(wide, full, a, which, by_a, by_conjugate)
    growth = fastest(by_a(which, which), by_conjugate(which, which))
  end subroutine far_growth

  !> Error of the growth of modes at rest, also if the motion itself is exact. The next order
  !! changes both derivatives by a fraction D of the frequency, with either sign. D is about the
  !! cube of the ratio of successive orders, so that the orders after it add about D^(1/3) times
  !! as much. These are added in full, since in a tongue D itself may only rotate perturbations.
  subroutine resting_error(scales, full, a, growth, resting, error)
    type(multiple_scales_type), intent(inout) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    !> Amplitudes of a steady motion, in natural units.
    complex(wp), intent(in) :: a(:)
    !> The largest growth, and that of modes at rest by terms that are not part of the modulation
    !! equations.
    real(wp), intent(in) :: growth, resting
    real(wp), intent(out) :: error
    complex(wp), dimension(size(a), size(a)) :: by_a, by_conjugate, more, more_conjugate
    integer, allocatable :: which(:)
    real(wp) :: own, moved
    integer :: j, k, l

    error = 0.0_wp
    which = pack([(j, j=1, size(a))], .not. abs(a) > 0.0_wp)
    if (size(which) == 0) return
    call scales%flow%slopes(a, by_a, by_conjugate)
    more = by_a
    more_conjugate = by_conjugate
    call add_next_order(scales, full, a, which, more, more_conjugate)
    more = more - by_a
    more_conjugate = more_conjugate - by_conjugate
    own = largest(0, 0)
    do k = -1, 1, 2
      do l = -1, 1, 2
        error = max(error, abs(largest(k, l) - own))
      end do
    end do
    associate (frame => minval(scales%flow%frame(which)))
      moved = maxval(abs(more(which, which)) + abs(more_conjugate(which, which)))/frame
      error = error + frame*moved*moved**(1.0_wp/3.0_wp)
    end associate
    ! Only the part that exceeds a larger growth of another origin changes the result.
    error = max(error - (growth - max(own, resting)), 0.0_wp)

  contains

    real(wp) function largest(k, l)
      integer, intent(in) :: k, l
      largest = fastest(by_a(which, which) + k*more(which, which), &
                        by_conjugate(which, which) + l*more_conjugate(which, which))
    end function largest

  end subroutine resting_error

  !> Add the next order to the derivatives by the amplitudes of modes at rest: the changes that are
  !! constant in a mode's frame.
  subroutine add_next_order(scales, full, a, which, by_a, by_conjugate)
    type(multiple_scales_type), intent(inout) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    complex(wp), intent(in) :: a(:)
    integer, intent(in) :: which(:)
    complex(wp), intent(inout) :: by_a(:, :), by_conjugate(:, :)
    type(changes_type), allocatable :: changes(:)
    type(status_type) :: status
    integer :: i, j, k

    allocate (changes(size(which)))
    call answer_triples(scales%normal, scales%form, abs(a) > 0.0_wp, 1, status)
    if (status%failed()) return
    call find_changes(scales, full, a, which, little_of(scales, a), still, changes)
    do j = 1, size(which)
      associate (change => changes(j), own => which(j), frame => scales%flow%frame)
        do i = 1, size(change%frequency)
          do k = 1, size(a)
            if (abs(change%frequency(i) - frame(k)) > still*frame(k)) cycle
            if (change%by_conjugate(i)) then
              by_conjugate(k, own) = by_conjugate(k, own) + change%rates(k, i)
            else
              by_a(k, own) = by_a(k, own) + change%rates(k, i)
            end if
          end do
        end do
      end associate
    end do
  end subroutine add_next_order

end module viscovib_resting_modes
