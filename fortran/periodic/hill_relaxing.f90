!> Exponents of memory itself, which Hill's determinant is asked for first.
!!
!! Next to a rate at which memory fades, -r, what a kernel R leaves of a spring, 1 - R(s),
!! vanishes, or somewhat left of it if other springs remember less. They are real, or at i d/2
!! where orders are odd.
module viscovib_hill_relaxing
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: relaxing_points

  !> Exponents of memory itself are no faster, in nu.
  real(wp), parameter, public :: widest = 100.0_wp
  !> How much of the stiffness remembers.
  real(wp), parameter :: parts(2) = [1.0_wp, 0.3_wp]

contains

  !> Where 1 - part R(s) = 0 at real s, -range < s < 0, for every kernel in use.
  subroutine relaxing_points(system, range, points)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: range
    real(wp), allocatable, intent(out) :: points(:)
    real(wp) :: s
    integer :: i, q
    logical :: made

    allocate (points(0))
    do q = 1, size(system%kernels)
      if (.not. any(system%kernel_of == q)) cycle
      do i = 1, merge(1, size(parts), all(system%kernel_of == q))
        call relaxing(system, q, parts(i), range, s, made)
        if (.not. made) exit
        points = [points, s]
      end do
    end do
  end subroutine relaxing_points

  !> Where part R(s) = 1 at real s, 0 > s > -range: R grows from s = 0 to its first singularity, and
  !! is no positive real number behind it.
  subroutine relaxing(system, q, part, range, s, made)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: q
    real(wp), intent(in) :: part, range
    real(wp), intent(out) :: s
    logical, intent(out) :: made
    complex(wp) :: r(1)
    real(wp) :: low, high, last
    integer :: i

    made = .false.
    s = 0.0_wp
    ! With a factor below 0 springs stiffen: R grows nowhere above 0.
    if (.not. system%kernels(q)%factor > 0.0_wp) return
    if (.not. system%kernels(q)%integral() < 1.0_wp/part) return
    ! Above the root at low, below it, or behind the singularity, at high.
    low = 0.0_wp
    high = 0.0_wp
    last = 0.0_wp
    s = 1.0e-12_wp*range
    do while (s < range)
      call system%kernels(q)%laplace([cmplx(-s, 0.0_wp, wp)], r)
      if (beyond()) then
        high = s
        exit
      end if
      last = real(r(1))
      low = s
      s = 2.0_wp*s
    end do
    if (.not. high > 0.0_wp) return
    do i = 1, 60
      s = 0.5_wp*(low + high)
      call system%kernels(q)%laplace([cmplx(-s, 0.0_wp, wp)], r)
      if (beyond()) then
        high = s
      else
        low = s
        last = real(r(1))
      end if
      if (high - low <= 1.0e-14_wp*high) exit
    end do
    s = -low
    made = .true.

  contains

    logical function beyond()
      beyond = .true.
      if (.not. abs(r(1)) <= huge(1.0_wp)) return
      if (abs(aimag(r(1))) > 1.0e-12_wp*abs(real(r(1)))) return
      beyond = real(r(1)) < last .or. real(r(1))*part > 1.0_wp
    end function beyond

  end subroutine relaxing

end module viscovib_hill_relaxing
