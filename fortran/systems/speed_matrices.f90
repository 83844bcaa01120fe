!> Matrices in proportion to the speed of a rotor: M u'' + (C + w G) u' + (K + w K1 + w^2 K2) u.
module viscovib_speed_matrices
  use viscovib_checks, only: check_finite
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: speed_matrices

  !> Largest relative symmetric part of a skew matrix.
  real(wp), parameter :: skew = 1.0e-12_wp

  type :: speed_matrices
    !> G, skew, K1 and K2, shape (n, n); all or none are allocated.
    real(wp), allocatable :: gyroscopic(:, :), circulatory(:, :), centrifugal(:, :)
  contains
    procedure :: depends_on_speed
    procedure :: take_matrices
    procedure :: drop_matrices
    procedure :: matrices_of
  end type speed_matrices

contains

  !> True if damping or stiffness depend on the speed.
  pure logical function depends_on_speed(self)
    class(speed_matrices), intent(in) :: self
    depends_on_speed = allocated(self%gyroscopic)
  end function depends_on_speed

  !> Take the given matrices after a check. Matrices that are all 0 are left out.
  subroutine take_matrices(self, given, status)
    class(speed_matrices), intent(inout) :: self
    class(speed_matrices), intent(in) :: given
    type(status_type), intent(out) :: status
    real(wp), allocatable :: a(:, :)
    integer :: at(2)

    call set_ok(status)
    call self%drop_matrices()
    if (.not. given%depends_on_speed()) return
    call check_finite('gyroscopic', [given%gyroscopic], status)
    if (status%failed()) return
    call check_finite('circulatory', [given%circulatory], status)
    if (status%failed()) return
    call check_finite('centrifugal', [given%centrifugal], status)
    if (status%failed()) return
    a = abs(given%gyroscopic + transpose(given%gyroscopic))
    if (any(a > skew*maxval(abs(given%gyroscopic)))) then
      at = maxloc(a)
      associate (i => minval(at), j => maxval(at))
        call fail(status, status_input_error, 'gyroscopic', 'gyroscopic: must be skew, has ' &
                  //show(given%gyroscopic(i, j))//' in row '//show(i)//', column '//show(j) &
                  //' and '//show(given%gyroscopic(j, i))//' in row '//show(j)//', column ' &
                  //show(i))
      end associate
      return
    end if
    if (.not. any(abs(given%gyroscopic) > 0.0_wp .or. abs(given%circulatory) > 0.0_wp &
                  .or. abs(given%centrifugal) > 0.0_wp)) return
    self%gyroscopic = given%gyroscopic
    self%circulatory = given%circulatory
    self%centrifugal = given%centrifugal
  end subroutine take_matrices

  subroutine drop_matrices(self)
    class(speed_matrices), intent(inout) :: self
    if (self%depends_on_speed()) deallocate (self%gyroscopic, self%circulatory, self%centrifugal)
  end subroutine drop_matrices

  !> The matrices of some coordinates.
  pure function matrices_of(self, kept) result(found)
    class(speed_matrices), intent(in) :: self
    integer, intent(in) :: kept(:)
    type(speed_matrices) :: found
    if (.not. self%depends_on_speed()) return
    found%gyroscopic = self%gyroscopic(kept, kept)
    found%circulatory = self%circulatory(kept, kept)
    found%centrifugal = self%centrifugal(kept, kept)
  end function matrices_of

end module viscovib_speed_matrices
